"""The supervisor: each safety rule by name, then every phase against every event."""

import pytest

from companion.guidance import limits as rules
from companion.guidance.reasons import Reason
from companion.guidance.situation import EXIT_CODES, Outcome, Phase, Plan, Stream
from companion.guidance.target import TargetTier
from companion.vehicle import (
    FlightMode,
    LandedState,
    RequestKind,
    RequestState,
    RequestStatus,
    SystemStatus,
)
from tests.unit.supervisor_bench import TICK_S, Bench


def test_by_default_nothing_is_ever_asked_and_nothing_moves():
    bench = Bench()
    for _ in range(2000):
        directive = bench.tick()
        assert directive.request is None
        assert directive.stream in (Stream.NOTHING, Stream.ZERO)
    assert directive.phase is Phase.READY


def test_arrival_hands_over_and_stands_still_until_the_heartbeat_shows_hold():
    bench = Bench().engaged()
    directive = bench.tick(arrived=True, distance_m=4.0)
    assert directive.request is RequestKind.HOLD
    assert directive.phase is Phase.HANDING_OVER
    assert bench.tick(10).stream is Stream.HOLD
    bench.set(mode=FlightMode.HOLD)
    directive = bench.tick()
    assert directive.outcome is Outcome.ARRIVED
    assert EXIT_CODES[directive.outcome] == 0
    assert directive.stream is Stream.NOTHING


def test_a_hold_that_is_never_confirmed_is_not_success():
    bench = Bench().engaged()
    bench.tick(arrived=True)
    directive = bench.tick(round(rules.HANDOVER_TIMEOUT_S / TICK_S) + 2)
    assert directive.outcome is Outcome.COMMAND_FAILED
    assert directive.stream is Stream.NOTHING


@pytest.mark.parametrize(
    ("on_exit", "request_kind"),
    [(RequestKind.HOLD, RequestKind.HOLD), (RequestKind.LAND, RequestKind.LAND), (None, None)],
)
def test_signal_in_flight_gives_the_vehicle_back(on_exit, request_kind):
    bench = Bench(Plan(on_exit=on_exit)).engaged()
    directive = bench.tick(stop_requested=True)
    assert directive.request is request_kind
    if request_kind is None:
        assert directive.outcome is Outcome.STOPPED


def test_signal_before_the_flight_just_ends():
    bench = Bench()
    bench.tick(5)
    directive = bench.tick(stop_requested=True)
    assert directive.outcome is Outcome.STOPPED
    assert directive.request is None
    assert EXIT_CODES[directive.outcome] == 130


@pytest.mark.parametrize(
    ("age_s", "phase"),
    [
        (rules.POSITION_STALE_SOFT_S - 0.01, Phase.ENGAGED),
        (rules.POSITION_STALE_SOFT_S + 0.01, Phase.HOLDING),
        (rules.POSITION_STALE_HARD_S + 0.01, Phase.HANDING_OVER),
    ],
)
def test_a_stale_position_stops_on_both_sides_of_each_border(age_s, phase):
    bench = Bench().engaged()
    bench.now_s += TICK_S
    bench.set(heartbeat_time_s=bench.now_s, time_s=bench.now_s + TICK_S - age_s)
    directive = bench.tick(alive=False)
    assert directive.phase is phase
    assert (directive.stream is Stream.POLICY) == (phase is Phase.ENGAGED)


def test_after_a_silence_of_the_link_nothing_is_streamed_until_the_heartbeat_tells():
    """PX4 comes back to OFFBOARD by itself when a stream does, even out of a failsafe."""
    bench = Bench().engaged()
    heard_s = bench.now_s
    while bench.now_s < heard_s + rules.STREAM_GAP_S - TICK_S:
        directive = bench.tick(alive=False)
    assert (directive.phase, directive.stream) == (Phase.HANDING_OVER, Stream.ZERO)
    assert bench.tick(3, alive=False).stream is Stream.NOTHING
    bench.set(time_s=bench.now_s)  # positions come again; the HEARTBEAT is of before
    assert bench.tick(alive=False).stream is Stream.NOTHING
    bench.set(mode=FlightMode.RETURN)
    directive = bench.tick()
    assert (directive.outcome, directive.stream) == (Outcome.STOOD_DOWN, Stream.NOTHING)


def test_after_a_silence_a_vehicle_that_still_obeys_is_handed_over():
    bench = Bench().engaged()
    bench.tick(20, alive=False)
    assert bench.tick().stream is Stream.HOLD


@pytest.mark.parametrize("tier", [TargetTier.HOLD, TargetTier.LOST, TargetTier.NONE])
def test_a_silent_target_stops_the_vehicle_and_a_new_report_resumes(tier):
    bench = Bench().engaged()
    directive = bench.tick(target=tier)
    assert (directive.phase, directive.stream) == (Phase.HOLDING, Stream.HOLD)
    assert bench.tick(target=TargetTier.COAST).stream is Stream.POLICY


def test_a_target_silent_for_long_hands_over():
    bench = Bench().engaged()
    directive = bench.tick(target=TargetTier.LOST, target_age_s=rules.TARGET_LOST_S + 0.1)
    assert directive.request is RequestKind.HOLD
    bench.set(mode=FlightMode.HOLD)
    assert bench.tick().outcome is Outcome.TARGET_LOST


def test_one_bad_policy_output_holds_and_three_hand_over():
    bench = Bench().engaged()
    assert bench.tick(policy_failures=1).stream is Stream.HOLD
    assert bench.tick(policy_failures=0).stream is Stream.POLICY
    assert bench.tick(policy_failures=rules.POLICY_FAILURES).request is RequestKind.HOLD


def test_a_moved_frame_holds_until_it_has_settled():
    bench = Bench().engaged()
    assert bench.tick(frame_moved=True).stream is Stream.ZERO
    assert bench.tick(round(rules.FRAME_SETTLE_S / TICK_S) - 2, frame_moved=False).stream is (
        Stream.ZERO
    )
    assert bench.tick(4).stream is Stream.POLICY


IN_DOUBT = [
    pytest.param({"position_valid": False}, {}, id="not vouched for"),
    pytest.param({}, {"position_frozen": True}, id="frozen"),
    pytest.param({}, {"frame_moved": True}, id="frame moved"),
    pytest.param({}, {"frame_untied": "3 m apart"}, id="frame untied"),
    pytest.param({}, {"off_map_m": rules.OFF_MAP_M + 1.0}, id="outside the map"),
]
KNOWN = [
    pytest.param({"target": TargetTier.LOST}, id="target silent"),
    pytest.param({"target_off_map_m": rules.OFF_MAP_M + 1.0}, id="target outside"),
    pytest.param({"policy_failures": 1}, id="policy unusable"),
]


@pytest.mark.parametrize(("vehicle", "doubt"), IN_DOUBT)
def test_where_nobody_knows_the_place_plain_zero_is_streamed_and_not_for_long(vehicle, doubt):
    bench = Bench().engaged()
    bench.set(**vehicle)
    ticks = round(rules.DOUBT_LIMIT_S / TICK_S)
    directive = bench.tick(ticks - 2, **doubt)
    assert (directive.phase, directive.stream) == (Phase.HOLDING, Stream.ZERO)
    assert bench.asked == []
    directive = bench.tick(4)
    assert (directive.phase, directive.stream) == (Phase.HANDING_OVER, Stream.ZERO)
    assert bench.asked == [RequestKind.HOLD]


def test_a_late_position_is_in_doubt():
    bench = Bench().engaged()
    directive = bench.tick(round(rules.POSITION_STALE_SOFT_S / TICK_S) + 1, alive=False)
    assert (directive.phase, directive.stream) == (Phase.HOLDING, Stream.ZERO)


@pytest.mark.parametrize("why", KNOWN)
def test_where_the_place_is_known_the_shield_may_lean(why):
    bench = Bench().engaged()
    directive = bench.tick(round(rules.HOLDING_LIMIT_S / TICK_S) - 2, **why)
    assert (directive.phase, directive.stream) == (Phase.HOLDING, Stream.HOLD)
    assert bench.asked == []
    directive = bench.tick(4)
    assert (directive.phase, directive.stream) == (Phase.HANDING_OVER, Stream.HOLD)


def test_a_moment_of_doubt_within_a_longer_hold_does_not_end_it():
    bench = Bench().engaged()
    bench.tick(round(1.5 * rules.DOUBT_LIMIT_S / TICK_S), target=TargetTier.LOST)
    assert bench.tick(frame_untied="3 m apart").stream is Stream.ZERO
    assert bench.tick(frame_untied="").stream is Stream.HOLD
    assert bench.asked == []


@pytest.mark.parametrize(("vehicle", "doubt"), IN_DOUBT)
def test_a_hand_over_goes_through_the_shield_while_the_vehicle_is_ours(vehicle, doubt):
    bench = Bench().engaged()
    assert bench.tick(stop_requested=True).stream is Stream.HOLD
    bench.set(**vehicle)
    assert bench.tick(**doubt).stream is Stream.ZERO


def test_a_climb_of_ardupilot_that_is_stopped_is_not_led_away_from_the_ground():
    """It climbs in GUIDED: the mode alone does not tell that we fly."""
    bench = Bench(Plan(engage=True, arm=True, takeoff_m=20.0, stream_before_external=False))
    for change in (
        {"mode": FlightMode.EXTERNAL, "mode_name": "GUIDED"},
        {"armed": True},
        {"landed": LandedState.IN_AIR},
    ):
        bench.tick()
        bench.answer()
        bench.set(**change)
    assert bench.tick(3, height_m=1.0).phase is Phase.TAKING_OFF
    directive = bench.tick(stop_requested=True)
    assert (directive.phase, directive.stream) == (Phase.HANDING_OVER, Stream.ZERO)


def test_before_the_vehicle_is_ours_a_hand_over_streams_zero():
    bench = Bench(Plan(engage=True)).in_the_air()
    bench.tick(round(1.0 / TICK_S))
    assert bench.asked == [RequestKind.EXTERNAL]
    directive = bench.tick(stop_requested=True)
    assert (directive.phase, directive.stream) == (Phase.HANDING_OVER, Stream.ZERO)


def test_no_progress_ends_and_a_moving_target_is_followed_on():
    ticks = round(rules.NO_PROGRESS_S / TICK_S) + 10
    bench = Bench().engaged()
    assert bench.tick(ticks, distance_m=30.0).request is None
    bench.set(mode=FlightMode.HOLD)
    assert bench.tick().outcome is Outcome.STUCK
    bench = Bench().engaged()
    assert bench.tick(ticks, distance_m=30.0, target_moving=True).stream is Stream.POLICY


def test_low_battery_refuses_and_hands_over():
    bench = Bench().in_the_air()
    bench.tick(3)
    bench.set(mode=FlightMode.EXTERNAL, battery_fraction=rules.BATTERY_ENGAGE - 0.01)
    assert bench.tick().outcome is Outcome.BATTERY_LOW
    bench = Bench().engaged()
    bench.set(battery_fraction=rules.BATTERY_HANDOVER - 0.01)
    assert bench.tick().request is RequestKind.HOLD


@pytest.mark.parametrize(
    "doubt", [{"position_valid": False}, {"mode_name": "OFFBOARD", "position_valid": False}]
)
def test_a_position_in_doubt_is_no_arrival(doubt):
    bench = Bench().engaged()
    bench.set(**doubt)
    directive = bench.tick(arrived=True, distance_m=1.0)
    assert (directive.phase, directive.stream) == (Phase.HOLDING, Stream.ZERO)
    bench = Bench().engaged()
    assert bench.tick(arrived=True, frame_moved=True).phase is Phase.HOLDING


def test_preflight_waits_then_refuses_with_what_is_missing():
    bench = Bench()
    assert bench.tick(waiting_for="no position").phase is Phase.PREFLIGHT
    directive = bench.tick(round(rules.PREFLIGHT_TIMEOUT_S / TICK_S) + 2)
    assert directive.outcome is Outcome.REFUSED
    assert "no position" in directive.reason


def test_shadow_decides_and_never_asks():
    bench = Bench(Plan(shadow=True)).in_the_air(FlightMode.OTHER)
    for _ in range(50):
        directive = bench.tick()
        assert directive.request is None
        assert directive.stream is not Stream.ZERO
    assert directive.phase is Phase.ENGAGED


EVENTS = {
    "takeover": ({"mode": FlightMode.OTHER}, {}),
    "failsafe": ({"mode": FlightMode.RETURN, "system_status": SystemStatus.CRITICAL}, {}),
    "disarm": ({"armed": False}, {}),
    "reboot": ({}, {"rebooted": True}),
    "foreign setpoints": ({}, {"foreign_setpoint": "system 1/192"}),
    "signal": ({}, {"stop_requested": True}),
    "pause": ({}, {"paused_by": "255/190"}),
    "frame contradicts itself": ({}, {"frame_untied": "4.0 m apart"}),
    "target lost": ({}, {"target": TargetTier.LOST, "target_age_s": 60.0}),
    "policy broken": ({}, {"policy_failures": 9}),
    "frame moved": ({}, {"frame_moved": True}),
    "position frozen": ({}, {"position_frozen": True}),
    "target outside the map": ({}, {"target_off_map_m": rules.OFF_MAP_M + 0.1}),
    "outside the map": ({}, {"off_map_m": rules.OFF_MAP_M + 0.1}),
    "estimator lost": ({"position_valid": False}, {"waiting_for": "the estimator"}),
    "position stale": ({"time_s": 0.0}, {}),
    "battery empty": ({"battery_fraction": 0.01}, {}),
    "arrived": ({}, {"arrived": True, "distance_m": 1.0}),
    "refused": ({}, {"request": RequestStatus(RequestKind.HOLD, RequestState.REJECTED)}),
}


def at_phase(phase):
    if phase is Phase.PREFLIGHT:
        bench = Bench()
        bench.tick(waiting_for="no position")
        return bench
    if phase is Phase.READY:
        bench = Bench().in_the_air()
        bench.tick(3)
    elif phase in (Phase.ARMING, Phase.TAKING_OFF):
        bench = Bench(Plan(engage=True, arm=True, takeoff_m=20.0))
        bench.tick()
        if phase is Phase.TAKING_OFF:
            bench.set(armed=True)
            bench.answer()
            bench.tick()
    elif phase is Phase.ENGAGING:
        bench = Bench(Plan(engage=True)).in_the_air()
        bench.tick(round(rules.IDLE_STREAM_S / TICK_S) + 3)
    else:
        bench = Bench().engaged()
        if phase is Phase.HOLDING:
            bench.tick(target=TargetTier.HOLD)
        elif phase is Phase.HANDING_OVER:
            bench.tick(arrived=True)
        elif phase is Phase.STOOD_DOWN:
            bench.set(mode=FlightMode.OTHER)
            bench.tick()
        elif phase is Phase.DONE:
            bench.tick(arrived=True)
            bench.set(mode=FlightMode.HOLD)
            bench.tick()
    assert bench.supervisor.phase is phase
    return bench


@pytest.mark.parametrize("event", EVENTS)
@pytest.mark.parametrize("phase", Phase)
def test_every_event_in_every_phase(phase, event):
    """Whatever happens, the policy's output leaves only in good order."""
    bench = at_phase(phase)
    vehicle, situation = EVENTS[event]
    bench.set(time_s=bench.now_s, heartbeat_time_s=bench.now_s)
    bench.set(**vehicle)
    directive = bench.tick(alive=False, **situation)
    if directive.stream is Stream.POLICY:
        assert event == "refused"
        assert directive.phase is Phase.ENGAGED
    if phase in (Phase.STOOD_DOWN, Phase.DONE):
        assert directive.phase is phase
        assert directive.stream is Stream.NOTHING
        assert directive.outcome is not None
    if event in ("takeover", "failsafe", "reboot", "foreign setpoints") and phase in (
        Phase.ENGAGED,
        Phase.HOLDING,
        Phase.HANDING_OVER,
    ):
        assert directive.phase is Phase.STOOD_DOWN
        assert directive.stream is Stream.NOTHING
    if directive.outcome is not None:
        assert directive.stream is Stream.NOTHING
        assert directive.outcome in EXIT_CODES


def test_a_pause_by_mavlink_gives_the_vehicle_back_for_good():
    bench = Bench().engaged()
    directive = bench.tick(paused_by="255/190")
    assert directive.request is RequestKind.HOLD
    bench.set(mode=FlightMode.HOLD)
    directive = bench.tick(paused_by="")
    assert (directive.outcome, directive.code) == (Outcome.STOOD_DOWN, Reason.PAUSED)
    assert "255/190" in directive.reason
    assert EXIT_CODES[directive.outcome] == 7


def test_a_frame_that_contradicts_itself_holds_and_then_hands_over():
    bench = Bench().engaged()
    directive = bench.tick(frame_untied="local and global position are 4.0 m apart")
    assert (directive.phase, directive.stream) == (Phase.HOLDING, Stream.ZERO)
    assert directive.code is Reason.FRAME_UNTIED
    assert bench.tick(frame_untied="").stream is Stream.POLICY
    directive = bench.tick(
        round(rules.DOUBT_LIMIT_S / TICK_S) + 3, frame_untied="local and global ..."
    )
    assert bench.asked == [RequestKind.HOLD]
    bench.set(mode=FlightMode.HOLD)
    directive = bench.tick()
    assert (directive.outcome, directive.code) == (Outcome.POSITION_LOST, Reason.FRAME_UNTIED)
    assert EXIT_CODES[directive.outcome] == 4


def test_a_contradicting_frame_keeps_the_flight_from_starting():
    bench = Bench(Plan(engage=True, arm=True, takeoff_m=20.0))
    directive = bench.tick(100, frame_untied="local and global position are 4.0 m apart")
    assert directive.phase is Phase.PREFLIGHT
    assert bench.asked == []
    assert bench.tick(frame_untied="").request is RequestKind.ARM


def test_every_transition_has_a_code_that_tells_it_from_the_others():
    bench = Bench().engaged()
    assert bench.tick().code is Reason.ENGAGED
    assert bench.tick(target=TargetTier.HOLD).code is Reason.TARGET_SILENT
    assert bench.tick(target=TargetTier.FRESH).code is Reason.RESUMED
    bench.set(mode=FlightMode.OTHER)
    assert bench.tick().code is Reason.MODE_CHANGED
