"""The supervisor: who may move the vehicle, and when to stop. One pure ``update`` a tick.

    PREFLIGHT -> READY -> (ARMING -> TAKING_OFF -> ENGAGING) -> ENGAGED <-> HOLDING
                   |                      |                         |
                   '----------------------+---- STOOD_DOWN <--------+   latched
                                          '---- HANDING_OVER <------'-> DONE

Rules, in order of rank (DESIGN 5): the pilot wins; nothing moves unasked; stale means stop.
PX4 takes OFFBOARD back by itself when a stream resumes, even from a pilot, so STOOD_DOWN has no
way out: the program ends, and only an operator who starts it again engages it again.
"""

from dataclasses import replace

from companion.guidance.limits import (
    BATTERY_ENGAGE,
    BATTERY_HANDOVER,
    CATCH_UP_S,
    FRAME_SETTLE_S,
    FRESH_HEARTBEAT_S,
    HANDOVER_TIMEOUT_S,
    IDLE_STREAM_S,
    KNOWN_MODE_S,
    LINK_LOST_S,
    NO_PROGRESS_S,
    POLICY_FAILURES,
    POSITION_STALE_HARD_S,
    POSITION_STALE_SOFT_S,
    PREFLIGHT_TIMEOUT_S,
    PROGRESS_M,
    STALL_S,
    STREAM_GAP_S,
    TAKEOFF_TIMEOUT_S,
    TAKEOFF_TOLERANCE_M,
    TARGET_LOST_S,
)
from companion.guidance.situation import Directive, Outcome, Phase, Plan, Situation, Stream
from companion.guidance.target import TargetTier
from companion.vehicle import (
    FlightMode,
    LandedState,
    RequestKind,
    RequestState,
    SystemStatus,
    VehicleState,
)

_COMMANDING = (Phase.ARMING, Phase.TAKING_OFF, Phase.ENGAGING)
_FLYING = (Phase.ENGAGED, Phase.HOLDING)
_CONFIRMED_MODE = {
    RequestKind.HOLD: FlightMode.HOLD,
    RequestKind.LAND: FlightMode.LAND,
    RequestKind.RETURN: FlightMode.RETURN,
}


class Supervisor:
    """The state machine of one run. It owns its phase and nothing else."""

    def __init__(self, plan: Plan, *, now_s: float) -> None:
        self._plan = plan
        self._phase = Phase.PREFLIGHT
        self._reason = "started"
        self._entered_s = now_s
        self._outcome: Outcome | None = None
        self._pending_outcome = Outcome.FAILED
        self._last_ask: RequestKind | None = None
        self._mode_before = ""
        self._climbing = False
        self._saw_climb = False
        self._saw_other_mode = False
        self._ready_stream_s: float | None = None
        self._best_distance_m = float("inf")
        self._progress_s = now_s
        self._frame_settled_s = now_s
        self._updated_s = now_s
        self._caught_up_s = now_s
        self._silent_since_s: float | None = None

    @property
    def phase(self) -> Phase:
        """Return the current phase."""
        return self._phase

    def update(self, s: Situation) -> Directive:
        """Return what to do in this tick.

        The checks run in order of rank; once there is an outcome, nothing changes it.
        """
        if self._outcome is not None:
            return self._directive(Stream.NOTHING)
        directive = (
            self._check_pilot(s)
            or self._check_link(s)
            or self._check_stall(s)
            or self._check_operator(s)
            or self._check_health(s)
        )
        if directive is not None:
            return directive
        if self._phase is Phase.PREFLIGHT:
            return self._preflight(s)
        if self._phase is Phase.HANDING_OVER:
            return self._hand_over(s)
        if self._phase in _FLYING:
            return self._fly(s)
        return self._prepare(s)

    # -- checks that hold in every phase ---------------------------------------------------

    def _check_pilot(self, s: Situation) -> Directive | None:
        """Stand down when somebody else has taken the vehicle."""
        v = s.vehicle
        if self._plan.shadow:
            return None
        if s.foreign_setpoint and self._phase is not Phase.PREFLIGHT:
            return self._stand_down(s, f"foreign setpoints from {s.foreign_setpoint}")
        if self._phase not in (*_COMMANDING, *_FLYING, Phase.HANDING_OVER):
            return None
        if s.rebooted:
            return self._stand_down(s, "the autopilot rebooted")
        if v is None:
            return self._stand_down(s, "the vehicle's state is gone")
        if v.system_status >= SystemStatus.CRITICAL:
            return self._stand_down(
                s, f"autopilot failsafe ({v.mode_name}, {v.system_status.name})"
            )
        if self._phase in _FLYING:
            if v.mode is not FlightMode.EXTERNAL:
                return self._stand_down(s, f"mode changed to {v.mode_name}")
            if not v.armed:
                return self._stand_down(s, "disarmed")
        elif self._phase in _COMMANDING and not self._mode_is_ours(v):
            return self._stand_down(s, f"mode changed to {v.mode_name}")
        elif self._phase is Phase.HANDING_OVER and v.mode_name != self._mode_before:
            asked = _CONFIRMED_MODE.get(self._last_ask) if self._last_ask else None
            if v.mode is not asked:
                return self._stand_down(s, f"mode changed to {v.mode_name}")
        return None

    def _check_link(self, s: Situation) -> Directive | None:
        if s.vehicle is None or self._phase is Phase.PREFLIGHT:
            return None
        silence_s = s.now_s - max(s.vehicle.heartbeat_time_s, s.vehicle.time_s)
        heartbeat_age_s = s.now_s - s.vehicle.heartbeat_time_s
        if silence_s > LINK_LOST_S or heartbeat_age_s > 2 * LINK_LOST_S:
            return self._finish(s, Outcome.LINK_LOST, f"nothing heard for {silence_s:.1f} s")
        return None

    def _check_stall(self, s: Situation) -> Directive | None:
        """After an absence of the loop itself, look before anything is asked or sent."""
        gap_s, self._updated_s = s.now_s - self._updated_s, s.now_s
        v = s.vehicle
        if self._phase not in (*_COMMANDING, *_FLYING) or v is None or self._plan.shadow:
            return None
        if gap_s > STALL_S:
            self._caught_up_s = s.now_s + CATCH_UP_S
        if gap_s > STREAM_GAP_S:
            self._silent_since_s = s.now_s
        if self._silent_since_s is not None:
            if v.heartbeat_time_s > self._silent_since_s:
                self._silent_since_s = None
            elif s.now_s - self._silent_since_s > 2 * KNOWN_MODE_S:
                return self._finish(s, Outcome.LINK_LOST, "no heartbeat after a stall of ours")
            else:
                return self._directive(Stream.NOTHING)
        if s.now_s >= self._caught_up_s:
            return None
        return self._directive(Stream.ZERO if self._phase in _FLYING else Stream.NOTHING)

    def _check_operator(self, s: Situation) -> Directive | None:
        if not s.stop_requested or self._phase is Phase.HANDING_OVER:
            return None
        return self._end(s, Outcome.STOPPED, "stopped by signal")

    def _check_health(self, s: Situation) -> Directive | None:
        v = s.vehicle
        if self._phase not in _FLYING or v is None:
            return None
        position_age_s = s.now_s - v.time_s
        if position_age_s > POSITION_STALE_HARD_S:
            return self._end(s, Outcome.LINK_LOST, f"position is {position_age_s:.2f} s old")
        if s.policy_failures >= POLICY_FAILURES:
            return self._end(s, Outcome.FAILED, "the policy's output is not usable")
        if s.target_age_s > TARGET_LOST_S:
            return self._end(s, Outcome.TARGET_LOST, f"target silent for {s.target_age_s:.0f} s")
        if _battery_below(v, BATTERY_HANDOVER):
            return self._end(s, Outcome.BATTERY_LOW, _battery_words(v))
        return None

    # -- phases ------------------------------------------------------------------------------

    def _preflight(self, s: Situation) -> Directive:
        if s.refusal:
            return self._finish(s, Outcome.REFUSED, s.refusal)
        if s.foreign_setpoint:
            return self._finish(
                s, Outcome.REFUSED, f"{s.foreign_setpoint} already sends setpoints to this vehicle"
            )
        if not s.waiting_for:
            self._enter(Phase.READY, "preflight passed", s.now_s)
            return self._prepare(s)
        if s.now_s - self._entered_s > PREFLIGHT_TIMEOUT_S:
            return self._finish(
                s,
                Outcome.REFUSED,
                f"not ready after {PREFLIGHT_TIMEOUT_S:.0f} s: {s.waiting_for}",
            )
        self._reason = f"waiting: {s.waiting_for}"
        return self._directive(Stream.NOTHING)

    def _prepare(self, s: Situation) -> Directive:
        """READY, ARMING, TAKING_OFF, ENGAGING: from the ground into the external mode."""
        v = s.vehicle
        if v is None or (self._phase is Phase.READY and s.waiting_for):
            self._enter(Phase.PREFLIGHT, f"waiting: {s.waiting_for}", s.now_s)
            return self._directive(Stream.NOTHING)
        if self._phase in _COMMANDING and s.request.kind is self._last_ask:
            if s.request.state in (RequestState.REJECTED, RequestState.TIMED_OUT):
                what = f"{s.request.kind} {s.request.state}"
                detail = f": {s.request.detail}" if s.request.detail else ""
                return self._finish(s, Outcome.COMMAND_FAILED, what + detail)
            if s.request.state is RequestState.PENDING:
                return self._directive(self._idle_stream(s))
        self._saw_other_mode |= v.mode is not FlightMode.EXTERNAL or not _airborne(v)
        ask = self._next_ask(s, v)
        if ask is not None and self._phase is Phase.READY and _battery_below(v, BATTERY_ENGAGE):
            return self._finish(s, Outcome.REFUSED, _battery_words(v))
        if ask is not None:
            return self._ask(s, v, ask)
        if self._phase is Phase.TAKING_OFF and not self._at_height(s):
            self._saw_climb |= v.mode is FlightMode.TAKEOFF
            if self._saw_climb and v.mode is FlightMode.HOLD:
                return self._stand_down(s, f"the climb was stopped by {v.mode_name}")
            if s.now_s - self._entered_s > TAKEOFF_TIMEOUT_S:
                return self._finish(s, Outcome.COMMAND_FAILED, "the climb did not finish")
            return self._directive(self._idle_stream(s))
        if self._phase is Phase.TAKING_OFF and not self._plan.engage:
            self._enter(Phase.READY, "at height", s.now_s)
        # PX4 stays in OFFBOARD only while somebody streams; ArduPilot hovers in GUIDED by itself.
        alone = self._plan.engage and not self._plan.stream_before_external
        invited = self._saw_other_mode or alone or self._plan.shadow
        external = v.mode is FlightMode.EXTERNAL or self._plan.shadow
        if v.armed and _airborne(v) and external and invited:
            return self._engage(s)
        if self._phase is Phase.READY:
            self._reason = self._waiting_words(v)
        return self._directive(self._idle_stream(s))

    def _fly(self, s: Situation) -> Directive:
        v = s.vehicle
        if s.frame_moved:
            self._frame_settled_s = s.now_s + FRAME_SETTLE_S
        if s.distance_m is not None and s.distance_m < self._best_distance_m - PROGRESS_M:
            self._best_distance_m, self._progress_s = s.distance_m, s.now_s
        if s.target_moving:
            self._progress_s = s.now_s
        hold = ""
        if v is None or s.now_s - v.time_s > POSITION_STALE_SOFT_S:
            hold = "position is late"
        elif not v.position_valid:
            hold = "the estimator does not vouch for the position"
        elif s.now_s < self._frame_settled_s:
            hold = "the local frame has moved"
        elif s.waiting_for:
            hold = s.waiting_for
        elif s.target in (TargetTier.NONE, TargetTier.HOLD, TargetTier.LOST):
            hold = "the target is silent"
        elif s.policy_failures:
            hold = "the policy's output is not usable"
        if hold:
            self._progress_s = s.now_s
            if self._phase is not Phase.HOLDING or self._reason != hold:
                self._enter(Phase.HOLDING, hold, s.now_s)
            return self._directive(Stream.ZERO)
        if s.arrived:
            return self._end(s, Outcome.ARRIVED, f"{s.distance_m or 0.0:.1f} m from the target")
        if s.now_s - self._progress_s > NO_PROGRESS_S:
            return self._end(
                s,
                Outcome.STUCK,
                f"no nearer than {self._best_distance_m:.1f} m for {NO_PROGRESS_S:.0f} s",
            )
        if self._phase is Phase.HOLDING:
            self._enter(Phase.ENGAGED, "resumed", s.now_s)
        return self._directive(Stream.POLICY)

    def _hand_over(self, s: Situation) -> Directive:
        v, ask = s.vehicle, self._last_ask
        pending = self._pending_outcome
        if ask is None or (v is not None and v.mode is _CONFIRMED_MODE.get(ask)):
            return self._finish(s, pending, self._reason)
        failed = s.request.kind is ask and s.request.state in (
            RequestState.REJECTED,
            RequestState.TIMED_OUT,
        )
        if failed or s.now_s - self._entered_s > HANDOVER_TIMEOUT_S:
            outcome = Outcome.COMMAND_FAILED if pending is Outcome.ARRIVED else pending
            return self._finish(s, outcome, f"{self._reason}; {ask} not confirmed")
        return self._directive(Stream.ZERO)

    # -- transitions ---------------------------------------------------------------------------

    def _next_ask(self, s: Situation, v: VehicleState) -> RequestKind | None:
        """Return the next request on the way up, if the plan allows one now."""
        plan = self._plan
        if plan.shadow:
            return None
        external = v.mode is FlightMode.EXTERNAL
        if not _airborne(v) and not self._climbing:
            wants_up = plan.arm or plan.takeoff_m is not None
            if wants_up and plan.engage and not plan.stream_before_external and not external:
                return RequestKind.EXTERNAL
            if plan.arm and not v.armed:
                return RequestKind.ARM if v.ready_to_arm else None
            if plan.takeoff_m is not None and v.armed:
                return RequestKind.TAKEOFF
            return None
        if self._climbing and not self._at_height(s):
            return None
        if plan.engage and v.armed and _airborne(v) and not external:
            streamed = (
                self._ready_stream_s is not None and s.now_s - self._ready_stream_s >= IDLE_STREAM_S
            )
            fresh = s.now_s - v.heartbeat_time_s <= FRESH_HEARTBEAT_S
            if fresh and (streamed or not plan.stream_before_external):
                return RequestKind.EXTERNAL
        return None

    def _ask(self, s: Situation, v: VehicleState, ask: RequestKind) -> Directive:
        phase = {
            RequestKind.ARM: Phase.ARMING,
            RequestKind.TAKEOFF: Phase.TAKING_OFF,
            RequestKind.EXTERNAL: Phase.ENGAGING,
        }[ask]
        self._mode_before = v.mode_name
        self._last_ask = ask
        self._climbing |= ask is RequestKind.TAKEOFF
        self._enter(phase, f"asking for {ask}", s.now_s)
        return replace(self._directive(self._idle_stream(s)), request=ask)

    def _engage(self, s: Situation) -> Directive:
        v = s.vehicle
        if v is not None and _battery_below(v, BATTERY_ENGAGE):
            return self._end(s, Outcome.BATTERY_LOW, _battery_words(v))
        self._best_distance_m, self._progress_s = float("inf"), s.now_s
        self._enter(Phase.ENGAGED, "the vehicle obeys setpoints", s.now_s)
        return self._fly(s)

    def _end(self, s: Situation, outcome: Outcome, reason: str) -> Directive:
        """Give the vehicle back in an orderly way, as far as it is ours to give."""
        v = s.vehicle
        ours = self._phase in _FLYING or (
            self._phase in (Phase.TAKING_OFF, Phase.ENGAGING) and v is not None and v.armed
        )
        if not ours or v is None or self._plan.on_exit is None or self._plan.shadow:
            return self._finish(s, outcome, reason)
        if s.now_s - v.heartbeat_time_s > KNOWN_MODE_S:
            return self._finish(s, outcome, f"{reason}; mode not known, left to the autopilot")
        self._pending_outcome = outcome
        self._mode_before = v.mode_name
        self._last_ask = self._plan.on_exit
        self._enter(Phase.HANDING_OVER, reason, s.now_s)
        return replace(self._directive(Stream.ZERO), request=self._plan.on_exit)

    def _stand_down(self, s: Situation, reason: str) -> Directive:
        self._outcome = Outcome.STOOD_DOWN
        self._enter(Phase.STOOD_DOWN, reason, s.now_s)
        return self._directive(Stream.NOTHING)

    def _finish(self, s: Situation, outcome: Outcome, reason: str) -> Directive:
        self._outcome = outcome
        self._enter(Phase.DONE, reason, s.now_s)
        return self._directive(Stream.NOTHING)

    def _enter(self, phase: Phase, reason: str, now_s: float) -> None:
        self._phase, self._reason, self._entered_s = phase, reason, now_s

    # -- small questions -----------------------------------------------------------------------

    def _mode_is_ours(self, v: VehicleState) -> bool:
        """Return whether the mode is one that our own requests can have led to."""
        if v.mode is FlightMode.EXTERNAL:
            return True
        if self._phase is Phase.TAKING_OFF and self._saw_climb:
            return v.mode in (FlightMode.TAKEOFF, FlightMode.HOLD)
        climbs = self._phase is Phase.TAKING_OFF and v.mode is FlightMode.TAKEOFF
        return climbs or v.mode_name == self._mode_before

    def _at_height(self, s: Situation) -> bool:
        wanted_m = self._plan.takeoff_m or 0.0
        enough_m = wanted_m - max(TAKEOFF_TOLERANCE_M, 0.1 * wanted_m)
        climbs = s.vehicle is not None and s.vehicle.mode is FlightMode.TAKEOFF
        return s.height_m >= enough_m and not climbs

    def _idle_stream(self, s: Situation) -> Stream:
        """Zero velocity where the autopilot wants a stream before the mode, else nothing.

        Never during a failsafe: PX4 would leave it and come back to OFFBOARD by itself.
        """
        v = s.vehicle
        if not self._plan.stream_before_external or self._plan.shadow or v is None:
            return Stream.NOTHING
        others = self._phase is Phase.READY and v.armed and v.mode is FlightMode.EXTERNAL
        if v.system_status >= SystemStatus.CRITICAL or others:
            self._ready_stream_s = None
            return Stream.NOTHING
        if self._ready_stream_s is None:
            self._ready_stream_s = s.now_s
        return Stream.ZERO

    def _waiting_words(self, v: VehicleState) -> str:
        if not v.armed:
            return "waiting for ready-to-arm" if self._plan.arm else "waiting: the pilot arms"
        if not _airborne(v):
            return "waiting: the pilot takes off"
        if v.mode is FlightMode.EXTERNAL:
            return f"waiting: leave {v.mode_name} and select it again, or use --engage"
        return "waiting: the pilot selects OFFBOARD / GUIDED"

    def _directive(self, stream: Stream) -> Directive:
        if self._plan.shadow and stream is Stream.ZERO:
            stream = Stream.NOTHING
        return Directive(self._phase, stream, self._reason, outcome=self._outcome)


def _airborne(v: VehicleState) -> bool:
    return v.landed in (LandedState.IN_AIR, LandedState.LANDING)


def _battery_below(v: VehicleState, share: float) -> bool:
    return v.battery_fraction is not None and v.battery_fraction < share


def _battery_words(v: VehicleState) -> str:
    return f"battery at {100 * (v.battery_fraction or 0.0):.0f} %"
