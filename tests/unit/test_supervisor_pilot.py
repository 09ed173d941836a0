"""The pilot wins: take-overs, strangers, silence, and absences of our own."""

from dataclasses import replace

import pytest

from companion.guidance import limits as rules
from companion.guidance.situation import EXIT_CODES, Outcome, Phase, Plan, Stream
from companion.vehicle import (
    FlightMode,
    LandedState,
    RequestKind,
    SystemStatus,
)
from tests.unit.supervisor_bench import TICK_S, Bench


@pytest.mark.parametrize("mode", [m for m in FlightMode if m is not FlightMode.EXTERNAL])
def test_takeover_stops_the_stream_in_the_same_tick_and_for_ever(mode):
    bench = Bench().engaged()
    bench.tick(20)
    bench.set(mode=mode)
    directive = bench.tick()
    assert directive.stream is Stream.NOTHING
    assert directive.phase is Phase.STOOD_DOWN
    assert directive.outcome is Outcome.STOOD_DOWN
    bench.set(mode=FlightMode.EXTERNAL)
    for _ in range(200):
        directive = bench.tick()
        assert directive.stream is Stream.NOTHING
        assert directive.request is None
        assert directive.phase is Phase.STOOD_DOWN


@pytest.mark.parametrize(
    "change",
    [
        {"system_status": SystemStatus.CRITICAL},
        {"system_status": SystemStatus.EMERGENCY},
        {"armed": False},
    ],
)
def test_failsafe_and_disarm_stand_down(change):
    bench = Bench().engaged()
    bench.set(**change)
    assert bench.tick().phase is Phase.STOOD_DOWN


@pytest.mark.parametrize("changes", [{"rebooted": True}, {"foreign_setpoint": "system 1/192"}])
def test_reboot_and_foreign_setpoints_stand_down(changes):
    bench = Bench().engaged()
    directive = bench.tick(**changes)
    assert directive.phase is Phase.STOOD_DOWN
    assert directive.stream is Stream.NOTHING


def test_foreign_setpoints_before_the_flight_refuse_it():
    directive = Bench().tick(foreign_setpoint="system 1/192", waiting_for="no position")
    assert directive.outcome is Outcome.REFUSED


def test_pilot_takes_over_during_the_climb():
    bench = Bench(Plan(engage=True, arm=True, takeoff_m=20.0))
    bench.tick()
    bench.set(armed=True)
    bench.answer()
    assert bench.tick().request is RequestKind.TAKEOFF
    bench.set(mode=FlightMode.TAKEOFF, landed=LandedState.IN_AIR)
    bench.answer()
    bench.tick(10, height_m=5.0)
    bench.set(mode=FlightMode.OTHER)
    directive = bench.tick()
    assert directive.phase is Phase.STOOD_DOWN
    assert directive.stream is Stream.NOTHING


def test_pilot_stops_the_climb_by_selecting_hold():
    bench = Bench(Plan(engage=True, arm=True, takeoff_m=20.0))
    bench.tick()
    bench.set(armed=True)
    bench.answer()
    bench.tick()
    bench.set(mode=FlightMode.TAKEOFF, landed=LandedState.IN_AIR)
    bench.answer()
    bench.tick(10, height_m=5.0)
    bench.set(mode=FlightMode.HOLD)
    assert bench.tick(height_m=5.5).phase is Phase.STOOD_DOWN


def test_pilot_takes_over_while_handing_over():
    bench = Bench().engaged()
    bench.tick(arrived=True)
    bench.set(mode=FlightMode.OTHER)
    assert bench.tick().outcome is Outcome.STOOD_DOWN


def test_a_silent_link_ends_without_setpoints():
    bench = Bench().engaged()
    directive = bench.tick(round((rules.LINK_LOST_S + 1.0) / TICK_S), alive=False)
    assert directive.outcome is Outcome.LINK_LOST
    assert EXIT_CODES[directive.outcome] == 4


@pytest.mark.parametrize(
    ("age_s", "phase"),
    [
        (rules.HEARTBEAT_LATE_S - 0.1, Phase.ENGAGED),
        (rules.HEARTBEAT_LATE_S + 0.1, Phase.HOLDING),
        (rules.LINK_LOST_S + 0.1, Phase.DONE),
    ],
)
def test_positions_alone_do_not_tell_who_has_the_vehicle(age_s, phase):
    bench = Bench().engaged()
    heard_s = bench.now_s
    while bench.now_s < heard_s + age_s:
        bench.set(time_s=bench.now_s + TICK_S)
        directive = bench.tick(alive=False)
    assert directive.phase is phase
    assert (directive.stream is Stream.POLICY) == (phase is Phase.ENGAGED)
    assert bench.asked == []


def test_pilot_takes_over_in_the_climb_with_the_mode_it_was_in_before():
    bench = Bench(Plan(engage=True, arm=True, takeoff_m=20.0))
    bench.set(mode=FlightMode.OTHER)
    bench.tick()
    bench.set(armed=True)
    bench.answer()
    assert bench.tick().request is RequestKind.TAKEOFF
    bench.set(mode=FlightMode.TAKEOFF, landed=LandedState.IN_AIR)
    bench.answer()
    bench.tick(10, height_m=5.0)
    bench.set(mode=FlightMode.OTHER)
    directive = bench.tick(height_m=19.9)
    assert directive.phase is Phase.STOOD_DOWN
    assert RequestKind.EXTERNAL not in bench.asked


def test_somebody_elses_offboard_gets_no_stream_of_ours():
    for plan in (Plan(), Plan(engage=True)):
        bench = Bench(plan).in_the_air(FlightMode.EXTERNAL)
        for _ in range(100):
            directive = bench.tick()
            assert directive.stream is Stream.NOTHING
            assert directive.phase is Phase.READY


def stall(bench, duration_s):
    """Let the loop be away; return the first directive after it, on the old knowledge."""
    bench.now_s += duration_s
    return bench.tick(alive=False)


def test_after_a_long_stall_nothing_is_asked_and_nothing_streams():
    bench = Bench().engaged()
    directive = stall(bench, 3.0)
    assert directive.stream is Stream.NOTHING
    assert directive.request is None
    bench.set(mode=FlightMode.OTHER)
    directive = bench.tick()
    assert directive.outcome is Outcome.STOOD_DOWN
    assert bench.asked == []


def test_after_a_stall_longer_than_the_failsafe_a_new_heartbeat_decides():
    bench = Bench().engaged()
    assert stall(bench, 1.2).stream is Stream.NOTHING
    before_s = bench.vehicle.heartbeat_time_s
    for _ in range(6):
        bench.set(time_s=bench.now_s + TICK_S, heartbeat_time_s=before_s)
        assert bench.tick(alive=False).stream is Stream.NOTHING
    assert bench.tick().stream is Stream.POLICY


def test_a_stall_without_a_heartbeat_after_it_ends_in_silence():
    bench = Bench().engaged()
    stall(bench, 1.2)
    for _ in range(200):
        directive = bench.tick(alive=False)
        assert directive.stream is Stream.NOTHING
        assert directive.request is None
    assert directive.outcome is Outcome.LINK_LOST


def test_a_short_stall_waits_a_moment_and_goes_on():
    bench = Bench().engaged()
    bench.now_s += 0.5
    assert bench.tick().stream is Stream.ZERO
    assert bench.tick(8).stream is Stream.POLICY


def test_a_reboot_stands_down_though_the_state_is_gone_with_it():
    bench = Bench().engaged()
    bench.now_s += TICK_S
    situation = replace(bench.situation, now_s=bench.now_s, vehicle=None, rebooted=True)
    directive = bench.supervisor.update(situation)
    assert directive.phase is Phase.STOOD_DOWN
    assert "rebooted" in directive.reason
