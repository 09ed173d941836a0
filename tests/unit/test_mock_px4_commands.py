"""Commands to PX4 that are rare: their results and texts, as its source has them."""

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim.mock.bench import Bench
from sim.mock.placement import place_vehicle
from sim.mock.vehicle import Settings
from tests.unit.px4_bench import ACCEPTED, DENIED, FAILED, NAN, REJECTED, UNSUPPORTED

GCS = (255, 190)


def booted(**options):
    """One that is ready, with a ground station on its link, which gets the texts."""
    bench = Bench(**options)
    bench.run(2.0)
    bench.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3), identity=GCS)
    return bench


def texts(bench):
    bench.run(0.3)
    return bench.texts()


def mode(bench):
    bench.run(1.1)
    return bench.last("HEARTBEAT").custom_mode


@pytest.mark.parametrize(
    ("base_mode", "custom_mode"),
    [
        (4, 0x04040000),
        (64 | 8, 0x00030000),
        (64 | 16, 0x00070000),
        (64, 0x00010000),
    ],
    ids=["auto", "position", "stabilized", "manual"],
)
def test_a_base_mode_without_the_custom_bit_means_a_mode(base_mode, custom_mode):
    bench = booted()
    assert bench.command(176, base_mode) == ACCEPTED
    assert mode(bench) == custom_mode


def test_auto_without_a_sub_mode_is_mission_and_acro_is_known():
    bench = booted()
    assert bench.command(176, 1, 4, 0) == ACCEPTED
    assert mode(bench) == 0x04040000
    assert bench.command(176, 1, 5) == ACCEPTED
    assert mode(bench) == 0x00050000
    assert bench.last("HEARTBEAT").base_mode == 0x41


def test_a_refused_take_off_or_return_is_told_whoever_asks():
    bench = Bench(faults=["t=4,kind=gps_loss"])
    bench.run(2.0)
    bench.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3), identity=GCS)
    assert bench.command(400, 1) == ACCEPTED
    bench.run(7.5)
    bench.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3), identity=GCS)
    assert bench.command(22, 0, 0, 0, NAN, NAN, NAN, NAN) == REJECTED
    assert bench.command(20) == REJECTED
    said = texts(bench)
    assert "Switching to Takeoff is currently not available" in said
    assert "Switching to Return is currently not available" in said


@pytest.mark.parametrize(
    ("modes", "up", "result"),
    [
        ((1, 3), 500, ACCEPTED),
        ((1, 3), 700, REJECTED),
        ((1, 7), 500, REJECTED),
        ((1, 7), 0, ACCEPTED),
    ],
    ids=["position, centred", "position, up", "stabilized, centred", "stabilized, down"],
)
def test_a_pilot_arms_with_the_throttle_in_a_safe_position_only(modes, up, result):
    bench = booted()
    assert bench.command(176, *modes) == ACCEPTED
    bench.send(mavlink.MAVLink_manual_control_message(1, 0, 0, up, 0, 0))
    assert bench.command(400, 1) == result
    denied = "Arming denied: throttle not in safe position"
    assert (denied in texts(bench)) is (result == REJECTED)


def test_the_number_to_arm_by_is_rounded():
    bench = booted()
    assert bench.command(400, 0.7) == ACCEPTED
    assert bench.command(400, 0.2) == ACCEPTED
    assert bench.command(400, 2.0) == UNSUPPORTED
    bench.run(1.1)
    assert bench.last("HEARTBEAT").base_mode & 128 == 0


def test_home_goes_where_it_is_put():
    bench = booted()
    assert bench.command(179, 0, 0, 0, 0, 47.3980, 8.5460, 495.0) == ACCEPTED
    home = bench.last("HOME_POSITION")
    assert (home.latitude, home.longitude) == pytest.approx((473980000, 85460000), abs=100)
    assert home.altitude == pytest.approx(495_000, abs=1)
    assert bench.command(179, 1) == ACCEPTED
    assert bench.last("HOME_POSITION").altitude == pytest.approx(489_400, abs=1)
    assert bench.command(179, 0, 0, 0, 0, NAN, 8.5, 495.0) == DENIED
    early = Bench(Settings(place_vehicle(None, None), boot_s=20.0))
    early.run(1.0)
    assert early.command(179, 1) == REJECTED


@pytest.mark.parametrize(
    ("number", "params", "result"),
    [
        (300, (0, 0), DENIED),
        (401, (), ACCEPTED),
        (246, (0,), ACCEPTED),
        (246, (1,), DENIED),
        (185, (1,), DENIED),
    ],
    ids=["start a mission", "run the checks", "reboot nothing", "reboot", "terminate"],
)
def test_results_of_other_commands(number, params, result):
    assert booted().command(number, *params) == result


@pytest.mark.parametrize("number", [30, 32, 0, 242])
def test_the_interval_of_a_message_can_be_asked_for(number):
    bench = booted()
    assert bench.command(510, number) == ACCEPTED
    answer = bench.last("MESSAGE_INTERVAL")
    expected = {30: 10_000, 32: 33_333, 0: 1_000_000, 242: 2_000_000}[number]
    assert (answer.message_id, answer.interval_us) == (number, expected)


def test_a_message_that_is_off_or_unknown_has_the_interval_zero():
    bench = booted()
    assert bench.command(511, 30, -1) == ACCEPTED
    for number in (30, 9999):
        assert bench.command(510, number) == ACCEPTED
        assert bench.last("MESSAGE_INTERVAL").interval_us == 0


@pytest.mark.parametrize(
    ("params", "result"),
    [
        ((0, 100_000), FAILED),
        ((30, 100_000, 1), FAILED),
        ((30, 100_000, 0, 0, 0, 0, 1), FAILED),
        ((30, 100_000, NAN, NAN, 0, 0, NAN), ACCEPTED),
        ((30, 1), ACCEPTED),
        ((30, 3e9), ACCEPTED),
        ((30, NAN), ACCEPTED),
    ],
    ids=["heartbeat", "param3", "response target", "not given", "1 us", "50 minutes", "no number"],
)
def test_absurd_intervals(params, result):
    bench = booted()
    assert bench.command(511, *params) == result
    bench.run(2.0)
    assert len(bench.all("HEARTBEAT", since_s=bench.time_s - 1.95)) == 2


@pytest.mark.parametrize("number", [9999, 70, 300])
def test_what_cannot_be_sent_is_denied(number):
    assert booted().command(512, number) == (ACCEPTED if number == 300 else DENIED)


def test_what_is_not_known_yet_is_denied():
    early = Bench(Settings(place_vehicle(None, None), boot_s=20.0))
    early.run(1.0)
    assert early.command(512, 33) == DENIED
    assert early.command(512, 242) == DENIED


def test_not_given_in_the_words_of_the_other_message_is_denied():
    bench = booted()
    no_number = 0x7FF80000
    message = mavlink.MAVLink_command_int_message(
        1, 1, 6, 192, 0, 0, -1, 1, 0, NAN, no_number, no_number, 500.0
    )
    assert bench.ask(message, 192) == DENIED
    largest = float(2**31 - 1)
    assert bench.command(192, -1, 1, 0, NAN, largest, largest, 500.0) == DENIED


def test_who_calls_himself_the_autopilot_is_not_obeyed():
    bench = booted()
    assert bench.command(400, 1, identity=(1, 1)) is None
    assert bench.command(512, 148, identity=(1, 1)) == ACCEPTED


def test_an_upload_of_no_items_clears_the_mission():
    bench = booted()
    for count, answer in ((0, 0), (3, 3)):
        bench.send(mavlink.MAVLink_mission_count_message(1, 1, count, 0))
        assert bench.last("MISSION_ACK").type == answer
