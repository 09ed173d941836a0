"""The supervisor: each safety rule by name, then every phase against every event."""

from dataclasses import replace

import numpy as np
import pytest

from companion.guidance import limits as rules
from companion.guidance.reasons import Reason
from companion.guidance.situation import EXIT_CODES, Outcome, Phase, Plan, Situation, Stream
from companion.guidance.supervisor import Supervisor
from companion.guidance.target import TargetTier
from companion.vehicle import (
    FlightMode,
    LandedState,
    RequestKind,
    RequestState,
    RequestStatus,
    SystemStatus,
    VehicleState,
)

TICK_S = 0.05
NAMES = {
    FlightMode.EXTERNAL: "OFFBOARD",
    FlightMode.HOLD: "AUTO.LOITER",
    FlightMode.TAKEOFF: "AUTO.TAKEOFF",
    FlightMode.LAND: "AUTO.LAND",
    FlightMode.RETURN: "AUTO.RTL",
    FlightMode.OTHER: "POSCTL",
}


class Bench:
    """A supervisor with a hand-driven vehicle in front of it."""

    def __init__(self, plan=None):
        self.now_s = 100.0
        self.asked = []
        self.supervisor = Supervisor(plan or Plan(), now_s=self.now_s)
        self.vehicle = VehicleState(
            time_s=self.now_s,
            position_ned_m=np.zeros(3),
            velocity_ned_mps=np.zeros(3),
            attitude_rad=np.zeros(3),
            heartbeat_time_s=self.now_s,
            mode=FlightMode.HOLD,
            mode_name="AUTO.LOITER",
            armed=False,
            landed=LandedState.ON_GROUND,
            system_status=SystemStatus.STANDBY,
            ready_to_arm=True,
            position_valid=True,
        )
        self.situation = Situation(
            now_s=self.now_s,
            vehicle=self.vehicle,
            request=RequestStatus(),
            target=TargetTier.FRESH,
            distance_m=50.0,
        )

    def set(self, **changes):
        """Change the vehicle's state; the mode's name follows the mode."""
        if "mode" in changes:
            changes.setdefault("mode_name", NAMES[changes["mode"]])
        self.vehicle = replace(self.vehicle, **changes)

    def tick(self, n=1, *, alive=True, **changes):
        """Let ``n`` ticks pass; return the last directive."""
        for _ in range(n):
            self.now_s += TICK_S
            if alive:
                self.set(time_s=self.now_s, heartbeat_time_s=self.now_s)
            self.situation = replace(
                self.situation, now_s=self.now_s, vehicle=self.vehicle, **changes
            )
            directive = self.supervisor.update(self.situation)
            if directive.request is not None:
                self.asked.append(directive.request)
                self.situation = replace(
                    self.situation,
                    request=RequestStatus(directive.request, RequestState.PENDING),
                )
        return directive

    def answer(self, state=RequestState.CONFIRMED, detail=""):
        kind = self.situation.request.kind
        self.situation = replace(self.situation, request=RequestStatus(kind, state, detail))

    def in_the_air(self, mode=FlightMode.HOLD):
        self.set(
            armed=True,
            landed=LandedState.IN_AIR,
            mode=mode,
            system_status=SystemStatus.ACTIVE,
        )
        return self

    def engaged(self):
        """Bring it to ENGAGED the way a pilot does."""
        self.in_the_air()
        self.tick(3)
        self.set(mode=FlightMode.EXTERNAL)
        assert self.tick().phase is Phase.ENGAGED
        return self


def test_by_default_nothing_is_ever_asked_and_nothing_moves():
    bench = Bench()
    for _ in range(2000):
        directive = bench.tick()
        assert directive.request is None
        assert directive.stream in (Stream.NOTHING, Stream.ZERO)
    assert directive.phase is Phase.READY


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


def test_px4_gets_an_idle_stream_but_never_in_a_failsafe():
    bench = Bench().in_the_air()
    assert bench.tick(3).stream is Stream.ZERO
    bench.set(system_status=SystemStatus.CRITICAL)
    assert bench.tick().stream is Stream.NOTHING


def test_ardupilot_gets_no_idle_stream():
    bench = Bench(Plan(stream_before_external=False)).in_the_air()
    assert bench.tick(3).stream is Stream.NOTHING


def climb(bench):
    """Walk a PX4 vehicle through arm, take-off and external mode; return the requests seen."""
    for _ in range(200):
        directive = bench.tick()
        if directive.request is None:
            continue
        bench.answer()
        if directive.request is RequestKind.ARM:
            bench.set(armed=True, system_status=SystemStatus.ACTIVE)
        elif directive.request is RequestKind.TAKEOFF:
            bench.set(mode=FlightMode.TAKEOFF, landed=LandedState.IN_AIR)
            bench.tick(40, height_m=10.0)
            bench.set(mode=FlightMode.HOLD)
            bench.situation = replace(bench.situation, height_m=19.5)
        elif directive.request is RequestKind.EXTERNAL:
            bench.set(mode=FlightMode.EXTERNAL)
    return bench.asked


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


def test_arrival_hands_over_and_streams_zero_until_the_heartbeat_shows_hold():
    bench = Bench().engaged()
    directive = bench.tick(arrived=True, distance_m=4.0)
    assert directive.request is RequestKind.HOLD
    assert directive.phase is Phase.HANDING_OVER
    assert bench.tick(10).stream is Stream.ZERO
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


def test_pilot_takes_over_while_handing_over():
    bench = Bench().engaged()
    bench.tick(arrived=True)
    bench.set(mode=FlightMode.OTHER)
    assert bench.tick().outcome is Outcome.STOOD_DOWN


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


@pytest.mark.parametrize("tier", [TargetTier.HOLD, TargetTier.LOST, TargetTier.NONE])
def test_a_silent_target_stops_the_vehicle_and_a_new_report_resumes(tier):
    bench = Bench().engaged()
    directive = bench.tick(target=tier)
    assert (directive.phase, directive.stream) == (Phase.HOLDING, Stream.ZERO)
    assert bench.tick(target=TargetTier.COAST).stream is Stream.POLICY


def test_a_target_silent_for_long_hands_over():
    bench = Bench().engaged()
    directive = bench.tick(target=TargetTier.LOST, target_age_s=rules.TARGET_LOST_S + 0.1)
    assert directive.request is RequestKind.HOLD
    bench.set(mode=FlightMode.HOLD)
    assert bench.tick().outcome is Outcome.TARGET_LOST


def test_one_bad_policy_output_holds_and_three_hand_over():
    bench = Bench().engaged()
    assert bench.tick(policy_failures=1).stream is Stream.ZERO
    assert bench.tick(policy_failures=0).stream is Stream.POLICY
    assert bench.tick(policy_failures=rules.POLICY_FAILURES).request is RequestKind.HOLD


def test_a_moved_frame_holds_until_it_has_settled():
    bench = Bench().engaged()
    assert bench.tick(frame_moved=True).stream is Stream.ZERO
    assert bench.tick(round(rules.FRAME_SETTLE_S / TICK_S) - 2, frame_moved=False).stream is (
        Stream.ZERO
    )
    assert bench.tick(4).stream is Stream.POLICY


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


def test_low_battery_refuses_before_the_vehicle_is_armed():
    bench = Bench(Plan(engage=True, arm=True, takeoff_m=20.0))
    bench.set(battery_fraction=rules.BATTERY_ENGAGE - 0.01)
    directive = bench.tick()
    assert directive.outcome is Outcome.REFUSED
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


def test_the_external_mode_is_asked_for_on_a_fresh_heartbeat_only():
    bench = Bench(Plan(engage=True)).in_the_air()
    bench.tick(3)
    heard_s = bench.now_s
    for _ in range(15):
        bench.now_s += TICK_S
        bench.set(time_s=bench.now_s, heartbeat_time_s=heard_s)
        assert bench.tick(alive=False).request is None
    assert bench.tick().request is RequestKind.EXTERNAL


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
        round(rules.HOLDING_LIMIT_S / TICK_S) + 3, frame_untied="local and global ..."
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
