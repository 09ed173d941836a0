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

from companion.guidance.absence import Absence, Returning, Silence
from companion.guidance.engagement import Engagement
from companion.guidance.holding import battery_below, battery_words, position_doubt, why_hold
from companion.guidance.limits import (
    BATTERY_ENGAGE,
    BATTERY_HANDOVER,
    DOUBT_LIMIT_S,
    FRAME_SETTLE_S,
    HANDOVER_TIMEOUT_S,
    HOLDING_LIMIT_S,
    KNOWN_MODE_S,
    LINK_LOST_S,
    NO_PROGRESS_S,
    POLICY_FAILURES,
    POSITION_STALE_HARD_S,
    PREFLIGHT_TIMEOUT_S,
    PROGRESS_M,
    TAKEOFF_TIMEOUT_S,
    TARGET_LOST_S,
)
from companion.guidance.reasons import Reason
from companion.guidance.situation import Directive, Outcome, Phase, Plan, Situation, Stream
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
_FAILED = (RequestState.REJECTED, RequestState.TIMED_OUT)
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
        self._code, self._reason = Reason.STARTED, "started"
        self._entered_s = now_s
        self._outcome: Outcome | None = None
        self._pending_outcome = Outcome.FAILED
        self._engagement = Engagement(plan)
        self._absence = Absence(now_s)
        self._silence = Silence()
        self._holding_since_s = now_s
        self._frame_settled_s = now_s
        self._doubt: tuple[Reason, str] | None = None
        self._trusted_s = now_s
        """When it was last known where the vehicle is."""
        self._was_ours = False
        """Whether the vehicle that is handed over was flown by us, not on its way up."""
        self._best_distance_m = float("inf")
        self._progress_s = now_s

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
        self._look_at_position(s)
        directive = (
            self._check_pilot(s)
            or self._check_link(s)
            or self._check_absence(s)
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
            words = f"foreign setpoints from {s.foreign_setpoint}"
            return self._stand_down(s, Reason.FOREIGN_SETPOINT, words)
        if self._phase not in (*_COMMANDING, *_FLYING, Phase.HANDING_OVER):
            return None
        if s.rebooted:
            return self._stand_down(s, Reason.REBOOT, "the autopilot rebooted")
        if v is None:
            return self._stand_down(s, Reason.STATE_GONE, "the vehicle's state is gone")
        if v.system_status >= SystemStatus.CRITICAL:
            words = f"autopilot failsafe ({v.mode_name}, {v.system_status.name})"
            return self._stand_down(s, Reason.FAILSAFE, words)
        if not self._mode_is_as_meant(v):
            return self._stand_down(s, Reason.MODE_CHANGED, f"mode changed to {v.mode_name}")
        if self._phase in _FLYING and not v.armed:
            return self._stand_down(s, Reason.DISARMED, "disarmed")
        return None

    def _mode_is_as_meant(self, v: VehicleState) -> bool:
        """Return whether nobody but us can have brought the vehicle into its mode."""
        if self._phase in _FLYING:
            return v.mode is FlightMode.EXTERNAL
        if self._phase in _COMMANDING:
            return self._engagement.mode_is_ours(v, self._phase)
        ask = self._engagement.last_ask
        asked = None if ask is None else _CONFIRMED_MODE.get(ask)
        return v.mode_name == self._engagement.mode_before or v.mode is asked

    def _check_link(self, s: Situation) -> Directive | None:
        if s.vehicle is None or self._phase is Phase.PREFLIGHT:
            return None
        silence_s = s.now_s - s.vehicle.heartbeat_time_s
        if silence_s > LINK_LOST_S:
            words = f"no heartbeat for {silence_s:.1f} s"
            return self._finish(s, Outcome.LINK_LOST, Reason.LINK_SILENT, words)
        return None

    def _check_absence(self, s: Situation) -> Directive | None:
        """After an absence of the loop itself, look before anything is asked or sent."""
        gap_s = self._absence.tick(s.now_s)
        v = s.vehicle
        if self._phase not in (*_COMMANDING, *_FLYING) or v is None or self._plan.shadow:
            return None
        match self._absence.returning(gap_s, s.now_s, v):
            case Returning.LOST:
                words = "no heartbeat after a stall of ours"
                return self._finish(s, Outcome.LINK_LOST, Reason.STALL, words)
            case Returning.SILENT:
                return self._directive(Stream.NOTHING)
            case Returning.LOOK:
                return self._directive(Stream.ZERO if self._phase in _FLYING else Stream.NOTHING)
            case Returning.GO_ON:
                return None

    def _check_operator(self, s: Situation) -> Directive | None:
        if self._phase is Phase.HANDING_OVER:
            return None
        if s.stop_requested:
            return self._end(s, Outcome.STOPPED, Reason.SIGNAL, "stopped by signal")
        if s.paused_by:
            words = f"paused by {s.paused_by} (DO_PAUSE_CONTINUE)"
            return self._end(s, Outcome.STOOD_DOWN, Reason.PAUSED, words)
        return None

    def _check_health(self, s: Situation) -> Directive | None:
        v = s.vehicle
        if self._phase not in _FLYING or v is None:
            return None
        position_age_s = s.now_s - v.time_s
        if position_age_s > POSITION_STALE_HARD_S:
            words = f"position is {position_age_s:.2f} s old"
            return self._end(s, Outcome.LINK_LOST, Reason.POSITION_LATE, words)
        if s.policy_failures >= POLICY_FAILURES:
            words = "the policy's output is not usable"
            return self._end(s, Outcome.FAILED, Reason.POLICY_UNUSABLE, words)
        if s.target_age_s > TARGET_LOST_S:
            words = f"target silent for {s.target_age_s:.0f} s"
            return self._end(s, Outcome.TARGET_LOST, Reason.TARGET_SILENT, words)
        if battery_below(v, BATTERY_HANDOVER):
            return self._end(s, Outcome.BATTERY_LOW, Reason.BATTERY_LOW, battery_words(v))
        return None

    # -- phases ------------------------------------------------------------------------------

    def _preflight(self, s: Situation) -> Directive:
        if s.refusal:
            return self._finish(s, Outcome.REFUSED, Reason.SITE, s.refusal)
        if s.foreign_setpoint:
            words = f"{s.foreign_setpoint} already sends setpoints to this vehicle"
            return self._finish(s, Outcome.REFUSED, Reason.FOREIGN_SETPOINT, words)
        missing = s.waiting_for or s.frame_untied
        if not missing:
            self._enter(Phase.READY, Reason.PREFLIGHT_PASSED, "preflight passed", s.now_s)
            return self._prepare(s)
        if s.now_s - self._entered_s > PREFLIGHT_TIMEOUT_S:
            words = f"not ready after {PREFLIGHT_TIMEOUT_S:.0f} s: {missing}"
            return self._finish(s, Outcome.REFUSED, Reason.NOT_READY, words)
        self._code, self._reason = Reason.WAITING, f"waiting: {missing}"
        return self._directive(Stream.NOTHING)

    def _prepare(self, s: Situation) -> Directive:
        """READY, ARMING, TAKING_OFF, ENGAGING: from the ground into the external mode."""
        v, way = s.vehicle, self._engagement
        missing = s.waiting_for or s.frame_untied
        if v is None or (self._phase is Phase.READY and missing):
            self._enter(Phase.PREFLIGHT, Reason.WAITING, f"waiting: {missing}", s.now_s)
            return self._directive(Stream.NOTHING)
        if self._phase in _COMMANDING and s.request.kind is way.last_ask:
            if s.request.state in _FAILED:
                return self._refused(s)
            if s.request.state is RequestState.PENDING:
                return self._directive(way.idle_stream(s, self._phase))
        way.look(v)
        ask = way.next_ask(s, v)
        if ask is not None and self._phase is Phase.READY and battery_below(v, BATTERY_ENGAGE):
            return self._finish(s, Outcome.REFUSED, Reason.BATTERY_LOW, battery_words(v))
        if ask is not None:
            return self._ask(s, v, ask)
        if self._phase is Phase.TAKING_OFF and not way.at_height(s, v):
            if way.climb_stopped(v):
                words = f"the climb was stopped by {v.mode_name}"
                return self._stand_down(s, Reason.CLIMB_STOPPED, words)
            if s.now_s - self._entered_s > TAKEOFF_TIMEOUT_S:
                words = "the climb did not finish"
                return self._finish(s, Outcome.COMMAND_FAILED, Reason.NO_ANSWER, words)
            return self._directive(way.idle_stream(s, self._phase))
        if self._phase is Phase.TAKING_OFF and not self._plan.engage:
            self._enter(Phase.READY, Reason.AT_HEIGHT, "at height", s.now_s)
        if way.may_fly(v):
            return self._engage(s, v)
        if self._phase is Phase.READY:
            self._code, self._reason = Reason.WAITING, way.waiting_words(v)
        return self._directive(way.idle_stream(s, self._phase))

    def _look_at_position(self, s: Situation) -> None:
        if s.frame_moved:
            self._frame_settled_s = s.now_s + FRAME_SETTLE_S
        self._doubt = position_doubt(s, self._frame_settled_s)
        if self._doubt is None:
            self._trusted_s = s.now_s

    def _fly(self, s: Situation) -> Directive:
        if s.target_changed:
            self._best_distance_m, self._progress_s = float("inf"), s.now_s
        if s.distance_m is not None and s.distance_m < self._best_distance_m - PROGRESS_M:
            self._best_distance_m, self._progress_s = s.distance_m, s.now_s
        if s.target_moving:
            self._progress_s = s.now_s
        hold = why_hold(s, self._doubt)
        if hold is not None:
            return self._hold(s, *hold)
        if s.arrived:
            words = f"{s.distance_m or 0.0:.1f} m from the target"
            return self._end(s, Outcome.ARRIVED, Reason.ARRIVED, words)
        if s.now_s - self._progress_s > NO_PROGRESS_S:
            words = f"no nearer than {self._best_distance_m:.1f} m for {NO_PROGRESS_S:.0f} s"
            return self._end(s, Outcome.STUCK, Reason.NO_PROGRESS, words)
        if self._phase is Phase.HOLDING:
            self._enter(Phase.ENGAGED, Reason.RESUMED, "resumed", s.now_s)
        return self._directive(Stream.POLICY)

    def _hold(self, s: Situation, code: Reason, words: str) -> Directive:
        """Stand still, but not for ever; while nobody knows where, not even for long."""
        self._progress_s = s.now_s
        if self._phase is not Phase.HOLDING:
            self._holding_since_s = s.now_s
        too_long = s.now_s - self._holding_since_s > HOLDING_LIMIT_S
        if too_long or s.now_s - self._trusted_s > DOUBT_LIMIT_S:
            outcome = Outcome.POSITION_LOST
            if code in (Reason.TARGET_SILENT, Reason.TARGET_OUTSIDE):
                outcome = Outcome.TARGET_LOST
            limit_s = HOLDING_LIMIT_S if too_long else DOUBT_LIMIT_S
            return self._end(s, outcome, code, f"{words} for {limit_s:.0f} s")
        if self._phase is not Phase.HOLDING or self._code is not code:
            self._enter(Phase.HOLDING, code, words, s.now_s)
        return self._directive(Stream.HOLD if self._doubt is None else Stream.ZERO)

    def _hand_over(self, s: Situation) -> Directive:
        v, ask, pending = s.vehicle, self._engagement.last_ask, self._pending_outcome
        answered = s.request.kind is ask
        if ask is RequestKind.DISARM:
            confirmed = answered and s.request.state is RequestState.CONFIRMED
        else:
            wanted = None if ask is None else _CONFIRMED_MODE.get(ask)
            confirmed = v is not None and v.mode is wanted
        failed = answered and s.request.state in _FAILED
        overdue = s.now_s - self._entered_s > HANDOVER_TIMEOUT_S
        if not (confirmed or failed or overdue):
            return self._directive(self._handover_stream(s, ask))
        if ask is not RequestKind.DISARM and v is not None and self._stands_armed_by_us(v):
            return self._ask_back(s, v, RequestKind.DISARM, self._code, self._reason)
        if confirmed:
            return self._finish(s, pending, self._code, self._reason)
        outcome = Outcome.COMMAND_FAILED if pending is Outcome.ARRIVED else pending
        return self._finish(s, outcome, self._code, f"{self._reason}; {ask} not confirmed")

    # -- transitions ---------------------------------------------------------------------------

    def _ask(self, s: Situation, v: VehicleState, ask: RequestKind) -> Directive:
        phase = {
            RequestKind.ARM: Phase.ARMING,
            RequestKind.TAKEOFF: Phase.TAKING_OFF,
            RequestKind.EXTERNAL: Phase.ENGAGING,
        }[ask]
        self._engagement.asked(ask, v)
        self._enter(phase, Reason.ASKED, f"asking for {ask}", s.now_s)
        return replace(self._directive(self._engagement.idle_stream(s, phase)), request=ask)

    def _refused(self, s: Situation) -> Directive:
        """End because the vehicle did not do what was asked; on the ground it is disarmed."""
        v, request = s.vehicle, s.request
        code = Reason.REJECTED if request.state is RequestState.REJECTED else Reason.NO_ANSWER
        words = f"{request.kind} {request.state}"
        if request.detail:
            words = f"{words}: {request.detail}"
        self._pending_outcome = Outcome.COMMAND_FAILED
        if v is not None and self._plan.on_exit is not None and self._stands_armed_by_us(v):
            return self._ask_back(s, v, RequestKind.DISARM, code, words)
        return self._finish(s, Outcome.COMMAND_FAILED, code, words)

    def _engage(self, s: Situation, v: VehicleState) -> Directive:
        if battery_below(v, BATTERY_ENGAGE):
            return self._end(s, Outcome.BATTERY_LOW, Reason.BATTERY_LOW, battery_words(v))
        self._best_distance_m, self._progress_s = float("inf"), s.now_s
        self._enter(Phase.ENGAGED, Reason.ENGAGED, "the vehicle obeys setpoints", s.now_s)
        return self._fly(s)

    def _end(self, s: Situation, outcome: Outcome, code: Reason, words: str) -> Directive:
        """Give the vehicle back in an orderly way, as far as it is ours to give."""
        v, back = s.vehicle, self._plan.on_exit
        flown = self._phase in (*_FLYING, Phase.TAKING_OFF, Phase.ENGAGING)
        if self._phase is Phase.ARMING:
            back = RequestKind.DISARM if back is not None else None
        elif not flown or v is None or not v.armed:
            back = None
        if v is None or back is None or self._plan.shadow:
            return self._finish(s, outcome, code, words)
        if s.now_s - v.heartbeat_time_s > KNOWN_MODE_S:
            words = f"{words}; mode not known, left to the autopilot"
            return self._finish(s, outcome, code, words)
        self._pending_outcome = outcome
        return self._ask_back(s, v, back, code, words)

    def _ask_back(
        self, s: Situation, v: VehicleState, ask: RequestKind, code: Reason, words: str
    ) -> Directive:
        """Ask the vehicle for the state we leave it in; the stream goes on until it shows."""
        self._engagement.asked(ask, v)
        self._was_ours = self._was_ours or self._phase in _FLYING
        self._enter(Phase.HANDING_OVER, code, words, s.now_s)
        return replace(self._directive(self._handover_stream(s, ask)), request=ask)

    def _handover_stream(self, s: Situation, ask: RequestKind | None) -> Stream:
        """Stand still in the air; on the ground what the autopilot needs, if anything.

        Nothing after a silence of the link, until it is known that no failsafe has the vehicle.
        """
        v = s.vehicle
        if ask is RequestKind.DISARM:
            return self._engagement.idle_stream(s, self._phase)
        if v is None or self._silence.mode_unknown(s.now_s, v):
            return Stream.NOTHING
        ours = self._was_ours and v.mode is FlightMode.EXTERNAL
        return Stream.HOLD if ours and self._doubt is None else Stream.ZERO

    def _stands_armed_by_us(self, v: VehicleState) -> bool:
        return self._engagement.has_armed and v.armed and v.landed is LandedState.ON_GROUND

    def _stand_down(self, s: Situation, code: Reason, words: str) -> Directive:
        self._outcome = Outcome.STOOD_DOWN
        self._enter(Phase.STOOD_DOWN, code, words, s.now_s)
        return self._directive(Stream.NOTHING)

    def _finish(self, s: Situation, outcome: Outcome, code: Reason, words: str) -> Directive:
        self._outcome = outcome
        self._enter(Phase.DONE, code, words, s.now_s)
        return self._directive(Stream.NOTHING)

    def _enter(self, phase: Phase, code: Reason, words: str, now_s: float) -> None:
        self._phase, self._code, self._reason, self._entered_s = phase, code, words, now_s

    def _directive(self, stream: Stream) -> Directive:
        if self._plan.shadow and stream is Stream.ZERO:
            stream = Stream.NOTHING
        return Directive(self._phase, stream, self._reason, self._code, outcome=self._outcome)
