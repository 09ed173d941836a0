"""From the ground into the external mode: what has been asked, and what may be asked next.

PX4 wants a stream before OFFBOARD and is asked for it in the air; ArduPilot's take-off dies of a
stream and begins in GUIDED. Nothing here sends or decides on its own: the supervisor asks.
"""

from companion.guidance.limits import FRESH_HEARTBEAT_S, IDLE_STREAM_S, TAKEOFF_TOLERANCE_M
from companion.guidance.situation import Phase, Plan, Situation, Stream
from companion.vehicle import FlightMode, LandedState, RequestKind, SystemStatus, VehicleState


class Engagement:
    """What this run has asked of the vehicle, and what it saw of it."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self.last_ask: RequestKind | None = None
        self.mode_before = ""
        """The mode when ``last_ask`` was asked."""
        self.has_armed = False
        """Whether this run has asked the vehicle to arm; then it may ask to disarm."""
        self._climbing = False
        self._saw_climb = False
        self._saw_other_mode = False
        self._stream_since_s: float | None = None

    def asked(self, ask: RequestKind, v: VehicleState) -> None:
        """Note a request that goes out in this tick."""
        self.last_ask, self.mode_before = ask, v.mode_name
        self.has_armed |= ask is RequestKind.ARM
        self._climbing |= ask is RequestKind.TAKEOFF

    def look(self, v: VehicleState) -> None:
        """Note what the vehicle shows while nothing is pending."""
        self._saw_other_mode |= v.mode is not FlightMode.EXTERNAL or not airborne(v)

    def next_ask(self, s: Situation, v: VehicleState) -> RequestKind | None:
        """Return the next request on the way up, if the plan allows one now."""
        plan = self._plan
        if plan.shadow:
            return None
        external = v.mode is FlightMode.EXTERNAL
        if not airborne(v) and not self._climbing:
            wants_up = plan.arm or plan.takeoff_m is not None
            if wants_up and plan.engage and not plan.stream_before_external and not external:
                return RequestKind.EXTERNAL
            if plan.arm and not v.armed:
                return RequestKind.ARM if v.ready_to_arm else None
            if plan.takeoff_m is not None and v.armed:
                return RequestKind.TAKEOFF
            return None
        if self._climbing and not self.at_height(s, v):
            return None
        if plan.engage and v.armed and airborne(v) and not external:
            since_s = self._stream_since_s
            streamed = since_s is not None and s.now_s - since_s >= IDLE_STREAM_S
            fresh = s.now_s - v.heartbeat_time_s <= FRESH_HEARTBEAT_S
            if fresh and (streamed or not plan.stream_before_external):
                return RequestKind.EXTERNAL
        return None

    def may_fly(self, v: VehicleState) -> bool:
        """Return whether the vehicle obeys setpoints, and somebody meant it to obey ours.

        PX4 stays in OFFBOARD only while somebody streams: one found there is flown by another.
        ArduPilot hovers in GUIDED by itself, so ``--engage`` may go on from there.
        """
        alone = self._plan.engage and not self._plan.stream_before_external
        invited = self._saw_other_mode or alone or self._plan.shadow
        external = v.mode is FlightMode.EXTERNAL or self._plan.shadow
        return v.armed and airborne(v) and external and invited

    def climb_stopped(self, v: VehicleState) -> bool:
        """Return whether somebody has ended the climb before its height; ask while climbing."""
        self._saw_climb |= v.mode is FlightMode.TAKEOFF
        return self._saw_climb and v.mode is FlightMode.HOLD

    def mode_is_ours(self, v: VehicleState, phase: Phase) -> bool:
        """Return whether the mode is one that our own requests can have led to."""
        if v.mode is FlightMode.EXTERNAL:
            return True
        if phase is Phase.TAKING_OFF and self._saw_climb:
            return v.mode in (FlightMode.TAKEOFF, FlightMode.HOLD)
        climbs = phase is Phase.TAKING_OFF and v.mode is FlightMode.TAKEOFF
        return climbs or v.mode_name == self.mode_before

    def at_height(self, s: Situation, v: VehicleState) -> bool:
        """Return whether the climb that the plan asks for is over."""
        wanted_m = self._plan.takeoff_m or 0.0
        enough_m = wanted_m - max(TAKEOFF_TOLERANCE_M, 0.1 * wanted_m)
        return s.height_m >= enough_m and v.mode is not FlightMode.TAKEOFF

    def idle_stream(self, s: Situation, phase: Phase) -> Stream:
        """Return zero velocity where the autopilot wants a stream before the mode, else nothing.

        Never during a failsafe: PX4 would leave it and come back to OFFBOARD by itself. Nor while
        it waits on the ground, where nothing can be engaged: PX4 would show OFFBOARD again after
        the landing that a failsafe led to.
        """
        v = s.vehicle
        if not self._plan.stream_before_external or self._plan.shadow or v is None:
            return Stream.NOTHING
        others = v.armed and v.mode is FlightMode.EXTERNAL
        unwanted = phase is Phase.READY and (others or not airborne(v))
        if v.system_status >= SystemStatus.CRITICAL or unwanted:
            self._stream_since_s = None
            return Stream.NOTHING
        if self._stream_since_s is None:
            self._stream_since_s = s.now_s
        return Stream.ZERO

    def waiting_words(self, v: VehicleState) -> str:
        """Return what the pilot has to do next."""
        if not v.armed and not self._plan.arm:
            return "waiting: the pilot arms"
        if not v.armed:
            stays = self._plan.stream_before_external and v.mode is FlightMode.EXTERNAL
            advice = f": {v.mode_name} wants a stream, select Hold first" if stays else ""
            return f"waiting for ready-to-arm{advice}"
        if not airborne(v):
            return "waiting: the pilot takes off"
        if v.mode is FlightMode.EXTERNAL:
            return f"waiting: leave {v.mode_name} and select it again, or use --engage"
        return "waiting: the pilot selects OFFBOARD / GUIDED"


def airborne(v: VehicleState) -> bool:
    """Return whether the vehicle is off the ground, not counting the first moment of a climb."""
    return v.landed in (LandedState.IN_AIR, LandedState.LANDING)
