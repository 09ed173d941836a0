"""From the ground into the external mode and back: what is asked, and what is left behind."""

import pytest

from companion.guidance import limits as rules
from companion.guidance.reasons import Reason
from companion.guidance.situation import EXIT_CODES, Outcome, Phase, Plan, Stream
from companion.vehicle import (
    FlightMode,
    LandedState,
    RequestKind,
    RequestState,
    SystemStatus,
)
from tests.unit.supervisor_bench import TICK_S, Bench, climb


def test_flies_when_the_pilot_selects_the_external_mode_in_the_air():
    bench = Bench().engaged()
    assert bench.tick().stream is Stream.POLICY


def test_external_mode_on_the_ground_does_not_engage():
    bench = Bench()
    bench.set(mode=FlightMode.EXTERNAL, armed=True)
    assert bench.tick(50).phase is Phase.READY


def test_a_vehicle_found_in_external_mode_waits_for_the_pilot_to_select_it_again():
    bench = Bench().in_the_air(FlightMode.EXTERNAL)
    directive = bench.tick(50)
    assert directive.phase is Phase.READY
    assert "--engage" in directive.reason
    bench.set(mode=FlightMode.HOLD)
    bench.tick(3)
    bench.set(mode=FlightMode.EXTERNAL)
    assert bench.tick().phase is Phase.ENGAGED


def test_px4_left_in_offboard_on_the_ground_cannot_be_armed_and_says_what_to_do():
    """PX4 1.16 goes back to OFFBOARD when it has landed from a flight whose companion died."""
    bench = Bench(Plan(arm=True, takeoff_m=10.0, engage=True))
    bench.set(mode=FlightMode.EXTERNAL, system_status=SystemStatus.UNINIT, ready_to_arm=False)
    directive = bench.tick(5)
    assert (
        directive.reason == "waiting for ready-to-arm: OFFBOARD wants a stream, select Hold first"
    )
    assert (directive.stream, bench.asked) == (Stream.NOTHING, [])


def test_px4_gets_an_idle_stream_but_never_in_a_failsafe():
    bench = Bench().in_the_air()
    assert bench.tick(3).stream is Stream.ZERO
    bench.set(system_status=SystemStatus.CRITICAL)
    assert bench.tick().stream is Stream.NOTHING


def test_ardupilot_gets_no_idle_stream():
    bench = Bench(Plan(stream_before_external=False)).in_the_air()
    assert bench.tick(3).stream is Stream.NOTHING


def test_from_the_ground_on_px4():
    bench = Bench(Plan(engage=True, arm=True, takeoff_m=20.0))
    assert climb(bench) == [RequestKind.ARM, RequestKind.TAKEOFF, RequestKind.EXTERNAL]
    assert bench.supervisor.phase is Phase.ENGAGED


def test_arm_and_takeoff_without_engage_wait_for_the_pilot_in_the_air():
    bench = Bench(Plan(arm=True, takeoff_m=20.0))
    assert climb(bench) == [RequestKind.ARM, RequestKind.TAKEOFF]
    assert bench.supervisor.phase is Phase.READY


def test_ardupilot_selects_guided_before_it_arms():
    bench = Bench(Plan(engage=True, arm=True, takeoff_m=20.0, stream_before_external=False))
    asked = []
    for _ in range(100):
        directive = bench.tick()
        if directive.request is not None:
            asked.append(directive.request)
            bench.answer()
            if directive.request is RequestKind.EXTERNAL:
                bench.set(mode=FlightMode.EXTERNAL, mode_name="GUIDED")
            elif directive.request is RequestKind.ARM:
                bench.set(armed=True)
            elif directive.request is RequestKind.TAKEOFF:
                bench.set(landed=LandedState.IN_AIR)
        if bench.vehicle.landed is LandedState.IN_AIR and bench.situation.height_m < 18.0:
            assert directive.stream is Stream.NOTHING, "a stream kills ArduPilot's take-off"
            bench.tick(1, height_m=bench.situation.height_m + 1.0)
    assert asked == [RequestKind.EXTERNAL, RequestKind.ARM, RequestKind.TAKEOFF]
    assert bench.supervisor.phase is Phase.ENGAGED


def test_does_not_arm_before_the_vehicle_is_ready():
    bench = Bench(Plan(engage=True, arm=True, takeoff_m=20.0))
    bench.set(ready_to_arm=False)
    assert bench.tick(100).phase is Phase.READY
    bench.set(ready_to_arm=True)
    assert bench.tick().request is RequestKind.ARM


@pytest.mark.parametrize("state", [RequestState.REJECTED, RequestState.TIMED_OUT])
def test_a_refused_command_ends_the_run_with_its_reason(state):
    bench = Bench(Plan(engage=True, arm=True, takeoff_m=20.0))
    assert bench.tick().request is RequestKind.ARM
    bench.answer(state, "TEMPORARILY_REJECTED")
    directive = bench.tick()
    assert directive.outcome is Outcome.COMMAND_FAILED
    assert "TEMPORARILY_REJECTED" in directive.reason
    assert EXIT_CODES[directive.outcome] == 6


def test_low_battery_refuses_before_the_vehicle_is_armed():
    bench = Bench(Plan(engage=True, arm=True, takeoff_m=20.0))
    bench.set(battery_fraction=rules.BATTERY_ENGAGE - 0.01)
    directive = bench.tick()
    assert directive.outcome is Outcome.REFUSED
    assert bench.asked == []


def test_the_external_mode_is_asked_for_on_a_fresh_heartbeat_only():
    bench = Bench(Plan(engage=True)).in_the_air()
    bench.tick(3)
    heard_s = bench.now_s
    for _ in range(15):
        bench.now_s += TICK_S
        bench.set(time_s=bench.now_s, heartbeat_time_s=heard_s)
        assert bench.tick(alive=False).request is None
    assert bench.tick().request is RequestKind.EXTERNAL


def armed_on_the_ground(plan=None):
    """Bring it to ARMING with the vehicle armed and nothing else asked."""
    bench = Bench(plan or Plan(engage=True, arm=True, takeoff_m=20.0))
    assert bench.tick().request is RequestKind.ARM
    bench.set(armed=True, system_status=SystemStatus.ACTIVE)
    return bench


@pytest.mark.parametrize("acknowledged", [False, True])
def test_a_signal_while_arming_disarms(acknowledged):
    bench = armed_on_the_ground()
    if acknowledged:
        bench.answer()
    directive = bench.tick(stop_requested=True)
    assert (directive.phase, directive.request) == (Phase.HANDING_OVER, RequestKind.DISARM)
    assert bench.tick(5).phase is Phase.HANDING_OVER
    bench.set(armed=False)
    bench.answer()
    directive = bench.tick()
    assert (directive.outcome, directive.code) == (Outcome.STOPPED, Reason.SIGNAL)
    assert "not confirmed" not in directive.reason


def test_a_signal_before_the_take_off_is_seen_holds_and_then_disarms():
    bench = armed_on_the_ground()
    bench.answer()
    assert bench.tick().request is RequestKind.TAKEOFF
    assert bench.tick(stop_requested=True).request is RequestKind.HOLD
    bench.set(mode=FlightMode.HOLD)
    bench.answer()
    assert bench.tick().request is RequestKind.DISARM
    bench.set(armed=False)
    bench.answer()
    assert bench.tick().outcome is Outcome.STOPPED


def test_a_vehicle_that_has_left_the_ground_is_never_disarmed():
    bench = armed_on_the_ground()
    bench.answer()
    bench.tick()
    bench.set(mode=FlightMode.TAKEOFF, landed=LandedState.IN_AIR)
    bench.answer()
    bench.tick(10, height_m=3.0)
    assert bench.tick(stop_requested=True).request is RequestKind.HOLD
    bench.set(mode=FlightMode.HOLD)
    assert bench.tick().outcome is Outcome.STOPPED
    assert RequestKind.DISARM not in bench.asked


def test_a_refused_take_off_does_not_leave_the_vehicle_armed():
    bench = armed_on_the_ground()
    bench.answer()
    assert bench.tick().request is RequestKind.TAKEOFF
    bench.answer(RequestState.REJECTED, "DENIED")
    assert bench.tick().request is RequestKind.DISARM
    bench.set(armed=False)
    bench.answer()
    directive = bench.tick()
    assert (directive.outcome, directive.code) == (Outcome.COMMAND_FAILED, Reason.REJECTED)
    assert "DENIED" in directive.reason


def test_a_vehicle_armed_by_its_pilot_is_never_disarmed():
    bench = Bench(Plan(engage=True, takeoff_m=20.0))
    bench.set(armed=True, system_status=SystemStatus.ACTIVE)
    assert bench.tick().request is RequestKind.TAKEOFF
    bench.tick(stop_requested=True)
    bench.set(mode=FlightMode.HOLD)
    bench.answer()
    bench.tick(200)
    assert RequestKind.DISARM not in bench.asked


def test_with_on_exit_none_nothing_is_asked_at_the_end():
    bench = armed_on_the_ground(Plan(engage=True, arm=True, takeoff_m=20.0, on_exit=None))
    assert bench.tick(stop_requested=True).outcome is Outcome.STOPPED
    assert bench.asked == [RequestKind.ARM]
