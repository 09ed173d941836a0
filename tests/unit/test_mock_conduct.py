"""The mock must make a bad companion fail visibly, and leave a good one in peace."""

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim.mock.ardupilot.personality import ARDUPILOT
from sim.mock.bench import Bench
from sim.mock.placement import place_vehicle
from sim.mock.vehicle import Settings

SET_MODE, ARM, TAKEOFF, LAND = 176, 400, 22, 21
NAN = math.nan
HEARS = ("LOCAL_POSITION_NED",)


def heartbeat(kind):
    return mavlink.MAVLink_heartbeat_message(kind, 8, 0, 0, 4, 3)


def fly_px4(**options):
    bench = Bench(hears=HEARS, **options)
    bench.run(2.0)
    bench.send(heartbeat(18))
    up = bench.velocity(0.0, 0.0, -1.0)
    bench.run(0.5, stream=up)
    assert bench.command(SET_MODE, 1.0, 6.0) == 0
    assert bench.command(ARM, 1.0) == 0
    bench.run(10.0, stream=up)
    return bench


def fly_ardupilot(**options):
    settings = Settings(place_vehicle(None, None, ARDUPILOT), personality=ARDUPILOT)
    bench = Bench(settings, hears=HEARS, **options)
    bench.run(2.0)
    bench.send(heartbeat(18))
    assert bench.command(SET_MODE, 1.0, 4.0) == 0
    assert bench.command(ARM, 1.0) == 0
    assert bench.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 8.0) == 0
    bench.run(12.0)
    bench.run(1.0, stream=bench.velocity(0.0, 0.0, 0.0))
    return bench


def kinds(bench):
    """Return the kinds of complaints, after a look at the whole verdict."""
    report = bench.vehicle.report()
    found = set().union(*report["complaints_by_sender"].values())
    assert report["passed"] is not bool(found)
    assert len(report["complaints"]) >= len(found)
    said = [line for line in bench.vehicle.take_log() if "complaint" in line]
    assert len(said) == len(found)
    return found


@pytest.fixture(params=[fly_px4, fly_ardupilot], ids=["px4", "ardupilot"])
def fly(request):
    return request.param


def test_a_good_flight_has_no_complaints(fly):
    bench = fly()
    bench.run(8.0, stream=bench.velocity(2.0, 0.5, 0.0))
    bench.command(LAND)
    bench.run(15.0)
    assert kinds(bench) == set()


@pytest.mark.parametrize("kind", ["rc_takeover", "gcs_mode"])
def test_a_companion_that_stops_at_a_takeover_is_left_in_peace(fly, kind):
    bench = fly(faults=[f"from=offboard,t=12,kind={kind}"])
    shown = bench.last("HEARTBEAT").custom_mode
    stream = bench.velocity(1.0, 0.0, 0.0)
    assert bench.run(
        20.0, stream=stream, until=lambda: bench.last("HEARTBEAT").custom_mode != shown
    )
    bench.run(10.0)
    assert kinds(bench) == set()


@pytest.mark.parametrize("kind", ["rc_takeover", "gcs_mode"])
def test_one_that_ignores_mode_changes_is_found_out(fly, kind):
    bench = fly(faults=[f"from=offboard,t=12,kind={kind}"])
    bench.run(20.0, stream=bench.velocity(1.0, 0.0, 0.0))
    assert kinds(bench) == {"ignores_mode"}


def test_one_that_keeps_streaming_after_its_own_request_to_land_does_not_ignore_the_pilot(fly):
    bench = fly()
    bench.command(LAND)
    bench.run(3.0, stream=bench.velocity(0.0, 0.0, 0.0))
    assert kinds(bench) == set()


def test_one_that_resumes_in_a_failsafe_is_found_out():
    bench = fly_px4()
    bench.run(4.0)  # silence: the failsafe returns the vehicle
    assert bench.last("HEARTBEAT").system_status == 5
    bench.run(2.0, stream=bench.velocity(1.0, 0.0, 0.0))
    assert "resumes_in_failsafe" in kinds(bench)


@pytest.mark.parametrize("pause_s", [2.0, 0.0])
def test_one_that_takes_control_back_is_found_out(fly, pause_s):
    bench = fly(faults=["from=offboard,t=12,kind=gcs_mode"])
    stream = bench.velocity(1.0, 0.0, 0.0)
    start = bench.last("HEARTBEAT").custom_mode
    assert bench.run(
        20.0, stream=stream, until=lambda: bench.last("HEARTBEAT").custom_mode != start
    )
    bench.run(pause_s)
    number = bench.vehicle.autopilot.external_mode_number
    bench.run(0.2, stream=stream)
    bench.command(SET_MODE, 1.0, number)
    assert "retakes_control" in kinds(bench)


@pytest.mark.parametrize("value", [NAN, math.inf, 1e6])
def test_one_that_sends_no_numbers_is_found_out(fly, value):
    bench = fly()
    bench.run(0.2, stream=bench.velocity(value, 0.0, 0.0))
    assert "bad_numbers" in kinds(bench)


def test_numbers_behind_the_mask_do_not_matter(fly):
    bench = fly()
    stream = bench.setpoint(
        type_mask=0xDC7, position=(NAN, NAN, NAN), velocity=(1.0, 0.0, 0.0), yaw=NAN
    )
    bench.run(1.0, stream=stream)
    assert kinds(bench) == set()


def test_one_that_speaks_in_a_wrong_frame_is_found_out(fly):
    bench = fly()
    bench.run(0.2, stream=bench.setpoint(type_mask=0xDC7, velocity=(1.0, 0.0, 0.0), frame=12))
    assert kinds(bench) == {"refused_setpoints"}


def test_one_that_floods_is_found_out(fly):
    bench = fly()
    flood = bench.velocity(1.0, 0.0, 0.0)
    for _ in range(150):
        for _ in range(4):
            bench.send(flood())
        bench.run(0.01)
    assert kinds(bench) == {"floods"}


def test_a_hundred_hertz_is_no_flood(fly):
    bench = fly()
    bench.run(2.0, stream=bench.velocity(1.0, 0.0, 0.0), rate_hz=100.0)
    assert kinds(bench) == set()


def test_one_that_hangs_while_its_last_setpoint_is_re_sent_is_found_out(fly):
    bench = fly()
    bench.run(70.0, stream=bench.velocity(1.0, 0.0, 0.0))
    assert kinds(bench) == {"stale_setpoints"}


def test_hovering_is_no_hanging(fly):
    bench = fly()
    bench.run(70.0, stream=bench.velocity(0.0, 0.0, 0.0))
    assert kinds(bench) == set()


def test_one_that_repeats_a_command_for_ever_is_found_out(fly):
    bench = fly()
    for _ in range(12):
        bench.command(ARM, 1.0, 0.0, NAN, NAN)
    assert kinds(bench) == {"repeats_commands"}


def test_asking_for_messages_again_and_again_is_allowed(fly):
    bench = fly()
    for _ in range(30):
        bench.command(512, 242.0)
    assert kinds(bench) == set()


@pytest.mark.parametrize("first", ["heartbeat", "setpoints"])
def test_one_that_calls_itself_a_ground_station_is_found_out(fly, first):
    bench = fly()
    if first == "heartbeat":
        bench.send(heartbeat(6), identity=(1, 195))
    bench.send(bench.velocity(0.0, 0.0, 0.0)(), identity=(1, 195))
    if first == "setpoints":
        bench.send(heartbeat(6), identity=(1, 195))
    assert kinds(bench) == {"heartbeat_as_gcs"}


def test_a_ground_station_that_does_not_fly_is_one(fly):
    bench = fly()
    bench.send(heartbeat(6), identity=(255, 190))
    bench.command(SET_MODE, 1.0, bench.vehicle.autopilot.external_mode_number)
    assert kinds(bench) == set()


def test_the_mocks_own_second_companion_is_not_judged(fly):
    bench = fly(faults=["from=offboard,t=1,kind=second_companion"])
    bench.run(2.0)
    assert kinds(bench) == set()


def set_mode(bench, custom_mode):
    bench.send(mavlink.MAVLink_set_mode_message(1, 1, custom_mode))


def test_one_that_leaves_an_axis_free_is_found_out(fly):
    bench = fly()
    bench.run(1.0, stream=bench.setpoint(type_mask=0xDE7, velocity=(1.0, 0.0, 0.0)))
    assert "free_axes" in kinds(bench)


@pytest.mark.parametrize("mask", [0xDC7, 0xDF8, 0xDC0, 0xDE3, 0xFC7], ids=hex)
def test_masks_that_leave_no_axis_free_are_in_order(mask):
    bench = fly_px4()
    bench.run(1.0, stream=bench.setpoint(type_mask=mask, position=(0.0, 0.0, -8.0)))
    assert "free_axes" not in kinds(bench)


def test_one_that_takes_control_back_by_set_mode_is_found_out_too(fly):
    bench = fly()
    autopilot = bench.vehicle.autopilot
    autopilot.choose_mode(autopilot.hold_mode, by_pilot=False)
    bench.run(1.5)
    set_mode(bench, 6 << 16 if bench.last("HEARTBEAT").autopilot == 12 else 4)
    assert "retakes_control" in kinds(bench)


def test_one_that_ends_its_control_by_set_mode_is_left_in_peace(fly):
    bench = fly()
    px4 = bench.last("HEARTBEAT").autopilot == 12
    set_mode(bench, 0x03040000 if px4 else 17)
    bench.run(3.0, stream=bench.velocity(0.0, 0.0, 0.0))
    assert kinds(bench) == set()


@pytest.mark.parametrize("spam", ["command", "message"])
def test_one_that_asks_for_its_mode_all_the_time_is_found_out(fly, spam):
    bench = fly()
    px4 = bench.last("HEARTBEAT").autopilot == 12
    for _ in range(12):
        if spam == "command":
            bench.command(SET_MODE, 1.0, 6.0 if px4 else 4.0)
        else:
            set_mode(bench, 6 << 16 if px4 else 4)
        bench.run(0.4, stream=bench.velocity(0.0, 0.0, 0.0))
    assert kinds(bench) == {"repeats_commands"}


def test_one_that_arms_in_a_loop_is_found_out():
    bench = Bench(hears=HEARS)
    for _ in range(12):
        bench.command(ARM, 1.0)
        bench.run(1.0)
    assert kinds(bench) == {"repeats_commands"}


def test_one_that_stops_the_motors_in_the_air_is_found_out(fly):
    bench = fly()
    assert bench.command(ARM, 0.0, 21196.0) == 0
    assert kinds(bench) == {"stops_motors"}
