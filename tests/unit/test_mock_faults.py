"""Faults of the mock vehicle: each does what it says, when it says, and is undone."""

import itertools
import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.errors import UsageError
from sim.mock.bench import Bench
from sim.mock.fault_kinds import KINDS
from sim.mock.faults import parse_fault
from sim.mock.placement import place_vehicle
from sim.mock.vehicle import Settings

ACCEPTED = 0


def flying(*faults, **options):
    bench = Bench(faults=faults, **options)
    bench.run(2.0)
    up = bench.position(0.0, 0.0, -10.0)
    bench.run(0.5, stream=up)
    assert bench.command(176, 1.0, 6.0) == ACCEPTED
    assert bench.command(400, 1.0) == ACCEPTED
    assert bench.run(15.0, stream=up, until=lambda: bench.last("LOCAL_POSITION_NED").z < -9.5)
    return bench


def hover(bench, duration_s, **options):
    return bench.run(duration_s, stream=bench.velocity(0.0, 0.0, 0.0), **options)


def count(bench, name, duration_s, link=0):
    before = len(bench.all(name, link=link))
    hover(bench, duration_s)
    return len(bench.all(name, link=link)) - before


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("t=1,kind=gremlins", "kind must be one of"),
        ("t=1", "kind must be one of"),
        ("t=1,kind=reboot,colour=red", "unknown key colour"),
        ("t=x,kind=reboot", "t must be a number"),
        ("t=-1,kind=reboot", "t must be a number of at least 0"),
        ("t=nan,kind=reboot", "t must be a number"),
        ("kind=reboot,kind=reboot", "expected key=value"),
        ("reboot", "expected key=value"),
        ("", "expected key=value"),
        ("kind=rc_takeover,mode=warp", "mode must be one of"),
        ("kind=loss,link=3", "only 1 links"),
        ("kind=loss,percent=500", "of at least 0 and at most 100"),
        ("kind=battery_low,level=20", "of at least 0 and at most 1"),
        ("kind=target_stale", "no such --target"),
        ("kind=reboot,from=lunch", "from must be one of"),
    ],
)
def test_nonsense_is_refused_in_one_line(text, complaint):
    with pytest.raises(UsageError, match=complaint) as caught:
        parse_fault(text, links=1, targets=[])
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_runs_in_flight_and_ends(kind):
    bench = flying(f"from=offboard,t=8,for=1,kind={kind}", targets=["kind=static,at=5:5:5"])
    hover(bench, 6.0)
    log = bench.vehicle.take_log()
    assert any(kind in line for line in log)


def test_rc_takeover_goes_to_position_mode_and_the_stream_does_not_win_it_back():
    bench = flying("from=offboard,t=8,kind=rc_takeover")
    hover(bench, 6.0)
    assert bench.last("HEARTBEAT").custom_mode == 0x00030000
    assert bench.last("HEARTBEAT").system_status == 4
    assert bench.last("RC_CHANNELS").chancount == 8
    assert bench.vehicle.report()["setpoints_outside_offboard"] > 50


def test_gcs_mode_change_sticks():
    bench = flying("from=offboard,t=8,kind=gcs_mode,mode=rtl")
    hover(bench, 6.0)
    assert bench.last("HEARTBEAT").custom_mode == 0x05040000


def test_gps_glitch_steps_both_positions_and_comes_back():
    bench = flying("from=offboard,t=8,kind=gps_glitch,size=15,for=2")
    hover(bench, 0.1)
    before = bench.last("LOCAL_POSITION_NED").y, bench.last("GLOBAL_POSITION_INT").lon
    assert hover(bench, 10.0, until=lambda: bench.vehicle.autopilot.estimator.glitching)
    hover(bench, 1.2)
    assert bench.last("LOCAL_POSITION_NED").y - before[0] == pytest.approx(15.0, abs=0.5)
    metres = (bench.last("GLOBAL_POSITION_INT").lon - before[1]) * 1e-7 * 111_195.0 * 0.677
    assert metres == pytest.approx(15.0, abs=0.6)
    assert bench.last("ESTIMATOR_STATUS").flags & 1024
    hover(bench, 2.5)
    assert bench.last("LOCAL_POSITION_NED").y == pytest.approx(before[0], abs=0.5)
    assert not bench.last("ESTIMATOR_STATUS").flags & 1024


def test_a_glitch_drags_a_holding_vehicle_off_its_place_and_a_reset_does_not():
    bench = flying()
    bench.command(176, 1.0, 4.0, 3.0)
    bench.run(3.0)
    body = bench.vehicle.autopilot.body
    before = body.position_m[1]
    home = bench.last("HOME_POSITION").longitude
    bench.vehicle.autopilot.reset_estimate((0.0, 5.0, 0.0))
    bench.run(5.0)
    assert body.position_m[1] == pytest.approx(before, abs=0.1)
    bench.vehicle.autopilot.mislead((0.0, 15.0, 0.0))
    bench.run(15.0)
    assert body.position_m[1] == pytest.approx(before - 15.0, abs=0.5)
    assert bench.last("HOME_POSITION").longitude == home


def test_ekf_reset_counts_once_and_steps():
    bench = flying()
    counter = bench.last("ODOMETRY").reset_counter
    north = bench.last("LOCAL_POSITION_NED").x
    bench.vehicle.autopilot.reset_estimate((3.0, 0.0, 0.0))
    hover(bench, 0.2)
    assert bench.last("ODOMETRY").reset_counter == counter + 1
    assert bench.last("LOCAL_POSITION_NED").x - north == pytest.approx(3.0, abs=0.1)


def test_origin_move_shifts_the_local_position_but_not_the_global_one():
    bench = flying("from=offboard,t=8,kind=origin_move,north=10,east=-4")
    assert hover(bench, 10.0, until=lambda: bench.vehicle.autopilot.estimator.origin_count > 0)
    local, world = bench.last("LOCAL_POSITION_NED"), bench.last("GLOBAL_POSITION_INT")
    hover(bench, 0.5)
    moved = bench.last("LOCAL_POSITION_NED")
    assert (moved.x - local.x, moved.y - local.y) == pytest.approx((-10.0, 4.0), abs=0.2)
    assert abs(bench.last("GLOBAL_POSITION_INT").lat - world.lat) < 20
    assert len(bench.all("GPS_GLOBAL_ORIGIN")) == 2


def test_gps_loss_lands_after_five_seconds_and_the_local_position_runs_away():
    bench = flying("from=offboard,t=8,kind=gps_loss")
    px4 = bench.vehicle.autopilot
    assert hover(bench, 10.0, until=lambda: px4.estimator.gps_lost_at_s is not None)
    lost_s = bench.time_s
    assert hover(bench, 10.0, until=lambda: px4.mode.name == "LAND")
    assert bench.time_s - lost_s == pytest.approx(5.3, abs=0.2)
    hover(bench, 4.0)
    assert bench.last("ESTIMATOR_STATUS").flags == 0x0065
    assert bench.last("HEARTBEAT").system_status == 5
    assert bench.last("LOCAL_POSITION_NED").x > 3.0


def test_setpoint_deaf_looks_like_a_dead_companion():
    bench = flying("from=offboard,t=8,kind=setpoint_deaf,for=3")
    px4 = bench.vehicle.autopilot
    assert hover(bench, 10.0, until=lambda: px4.mode.name == "RTL")
    hover(bench, 5.0)
    assert px4.mode.name == "OFFBOARD"


def test_link_loss_silences_both_directions_and_the_failsafe_acts():
    bench = flying("from=offboard,t=8,kind=link_loss,for=4")
    assert hover(bench, 10.0, until=lambda: bench.vehicle.impairments[0].cut > 0.0)
    assert count(bench, "HEARTBEAT", 3.0) == 0
    assert bench.vehicle.autopilot.mode.name == "RTL"
    assert count(bench, "HEARTBEAT", 3.0) >= 1


def test_link_faults_name_one_link():
    bench = flying("kind=link_loss,link=2,t=1", ground_links=(False, False))
    assert count(bench, "ATTITUDE", 1.0, link=0) > 90
    assert count(bench, "ATTITUDE", 1.0, link=1) == 0


def test_loss_takes_its_share():
    bench = Bench(faults=["kind=loss,percent=20"])
    bench.run(20.0)
    assert len(bench.all("ATTITUDE")) == pytest.approx(0.8 * 1950, rel=0.07)


def test_delay_with_jitter_reorders():
    bench = Bench(faults=["kind=delay,ms=100,jitter_ms=100,t=2"])
    bench.run(5.0)
    stamps = [message.time_boot_ms for message in bench.all("ATTITUDE")]
    assert stamps != sorted(stamps)
    newest = max(stamps)
    assert 100 <= 5000 - newest <= 160


def test_corrupt_packets_fail_their_checksum():
    bench = Bench(faults=["kind=corrupt,percent=100,t=2"])
    bench.run(3.0)
    spoilt = [r for r in bench.received if r.time_s > 2.1]
    assert len(spoilt) > 100
    for received in spoilt[:50]:
        parser = mavlink.MAVLink(None)
        parser.robust_parsing = True
        messages = parser.parse_buffer(received.packet) or []
        # A spoilt message id makes a message that nobody knows, unchecked as on a real link.
        assert all(m.get_type() == "BAD_DATA" or "UNKNOWN" in m.get_type() for m in messages)


def test_duplicates_arrive_twice():
    bench = Bench(faults=["kind=duplicate,percent=100,t=2"])
    bench.run(4.0)
    packets = [r.packet for r in bench.received if r.time_s > 2.5]
    assert len(packets) == pytest.approx(2 * len(set(packets)), rel=0.02)


def test_a_lost_acknowledgement_still_means_the_command_was_obeyed():
    bench = Bench(faults=["kind=ack_lost,t=1"])
    bench.run(2.0)
    assert bench.command(176, 1.0, 6.0) is None
    assert bench.vehicle.autopilot.mode.name == "OFFBOARD"
    assert bench.command(176, 1.0, 6.0) == ACCEPTED


def test_low_battery_is_shown_and_acts_only_if_told_to():
    bench = flying("from=offboard,t=8,kind=battery_low,level=0.06")
    bench.vehicle.autopilot.parameters.override("COM_LOW_BAT_ACT", 0)
    hover(bench, 6.0)
    assert bench.last("SYS_STATUS").battery_remaining == 6
    assert bench.vehicle.autopilot.mode.name == "OFFBOARD"
    bench.vehicle.autopilot.parameters.override("COM_LOW_BAT_ACT", 3)
    hover(bench, 2.0)
    assert bench.last("HEARTBEAT").custom_mode == 0x05040000
    assert bench.last("HEARTBEAT").system_status == 5


def test_geofence_breach_holds_and_cannot_be_flown_out_of():
    bench = flying("kind=geofence,radius=10,t=1")
    bench.run(9.0, stream=bench.velocity(3.0, 0.0, 0.0))
    assert bench.last("HEARTBEAT").custom_mode == 0x03040000
    assert bench.last("HEARTBEAT").system_status == 5
    assert bench.last("LOCAL_POSITION_NED").x < 16.0


def test_reboot_turns_the_clock_back_and_disarms():
    bench = Bench(faults=["t=5,kind=reboot"])
    bench.run(10.0)
    stamps = [message.time_boot_ms for message in bench.all("ATTITUDE")]
    drops = [b for a, b in itertools.pairwise(stamps) if b < a]
    assert len(drops) == 1
    assert len(bench.all("GPS_GLOBAL_ORIGIN")) == 2
    assert bench.last("HEARTBEAT").system_status == 3


def test_second_companion_is_seen_on_the_link_and_counted():
    bench = flying("from=offboard,t=8,kind=second_companion,for=3")
    hover(bench, 7.0)
    foreign = bench.all("SET_POSITION_TARGET_LOCAL_NED")
    assert {(m.get_srcSystem(), m.get_srcComponent()) for m in foreign} == {(1, 192)}
    assert len(foreign) == pytest.approx(30, abs=2)
    senders = bench.vehicle.report()["setpoints_by_sender"]
    assert senders["1/192"] == len(foreign)
    assert senders["1/191"] > 100


def target_reports(bench, since_s):
    return [m for m in bench.all("GLOBAL_POSITION_INT", since_s=since_s) if m.get_srcSystem() == 42]


def test_stale_target_falls_silent_and_returns():
    bench = Bench(targets=["kind=circle,at=0:30:10"], faults=["t=3,kind=target_stale,for=4"])
    bench.run(6.9)
    assert target_reports(bench, 3.1) == []
    bench.run(2.0)
    assert len(target_reports(bench, 7.05)) >= 8


def test_frozen_target_repeats_one_report():
    bench = Bench(targets=["kind=circle,at=0:30:10"], faults=["t=3,kind=target_freeze"])
    bench.run(6.0)
    assert len({(m.time_boot_ms, m.lat, m.lon) for m in target_reports(bench, 3.3)}) == 1


def test_target_jump_moves_the_report():
    bench = Bench(targets=["kind=static,at=0:30:10"], faults=["t=3,kind=target_jump,east=40"])
    bench.run(6.0)
    before, after = target_reports(bench, 0.0)[0], target_reports(bench, 0.0)[-1]
    metres = (after.lon - before.lon) * 1e-7 * 111_195.0 * math.cos(math.radians(47.3977))
    assert metres == pytest.approx(40.0, abs=0.3)


def test_the_same_seed_gives_the_same_bytes_and_another_one_does_not():
    settings = Settings(place_vehicle(None, None), noise_m=0.1, gust_mps=1.0)

    def fly(seed):
        bench = Bench(settings, targets=["kind=waypoints"], faults=["kind=loss,t=1"], seed=seed)
        bench.run(5.0)
        return [received.packet for received in bench.received]

    assert fly(3) == fly(3)
    assert fly(3) != fly(4)
