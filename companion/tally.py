"""What a flight comes to: counted tick by tick, with the places worth a mark on the map."""

from collections.abc import Callable

from companion.guidance.envelope import Envelope
from companion.guidance.reasons import Reason
from companion.guidance.shield import ShieldDecision
from companion.guidance.situation import Directive, Outcome, Phase, Situation
from companion.metrics import Metrics
from companion.positions import Pose
from companion.session.records import Mark, Record
from companion.session.summary import Summary
from companion.vehicle import LandedState, LinkStats
from companion.world.maps import Map
from companion.world.neighbourhood import Neighbourhood

_OURS = (Phase.ENGAGED, Phase.HOLDING, Phase.HANDING_OVER)
"""While the vehicle is ours to keep clear of things."""
_OFF_THE_GROUND = (LandedState.TAKING_OFF, LandedState.IN_AIR, LandedState.LANDING)
"""ArduPilot calls the whole climb a take-off: it is flown, too."""
_MARKED = (Phase.ENGAGED, Phase.HANDING_OVER, Phase.STOOD_DOWN)
"""What gets a label on the map."""


class Tally:
    """Counts one flight.

    Args:
        city: The map.
        record: Takes the marks.
        start_s: Now.
        rate_hz: Of the control loop.
    """

    def __init__(
        self, city: Map, record: Callable[[Record], None], *, start_s: float, rate_hz: float
    ) -> None:
        self.metrics = Metrics(start_s=start_s, rate_hz=rate_hz)
        self._record = record
        self._surroundings = Neighbourhood(city)
        self._marked: Phase | None = None

    def tick(
        self,
        directive: Directive,
        situation: Situation,
        pose: Pose | None,
        decision: ShieldDecision | None,
        envelope: Envelope,
    ) -> None:
        """Count one turn of the loop, after its setpoint has left."""
        state = situation.vehicle
        self.metrics.final_distance_m = situation.distance_m
        if pose is not None and state is not None and state.landed in _OFF_THE_GROUND:
            self.metrics.moved(pose.position_enu_m, pose.velocity_enu_mps)
            if directive.phase in _OURS:
                clearance_m = self._clearance_m(pose) if decision is None else decision.clearance_m
                self.metrics.cleared(clearance_m, pose.position_enu_m)
        if pose is not None and directive.phase is not self._marked:
            self._marked = directive.phase
            if directive.phase in _MARKED:
                label = f"{directive.phase} [{directive.code}]"
                self._record(Mark(label, pose.position_enu_m.tolist()))
        if decision is not None and decision.intervened:
            self.metrics.shield_reasons[decision.reason.value] += 1
        slowed = decision is not None and envelope.cap_mps is not None
        self.metrics.setpoints_slowed += slowed
        self.metrics.velocity_lag_s = envelope.known_lag_s
        self.metrics.takeovers += directive.phase is Phase.STOOD_DOWN

    def _clearance_m(self, pose: Pose) -> float:
        """Return the distance from the nearest obstacle or the ground, as the shield measures."""
        obstacles = self._surroundings.around(pose.position_enu_m).obstacles
        obstacle_m = float(obstacles.signed_distance_m(pose.position_enu_m))
        return min(obstacle_m, float(pose.position_enu_m[2]))

    def summary(
        self, outcome: Outcome, code: Reason, reason: str, *, now_s: float, stats: LinkStats
    ) -> Summary:
        """Return what was flown so far, and mark where it came nearest to an obstacle."""
        if self.metrics.closest_enu_m is not None:
            self._record(Mark("closest to an obstacle", self.metrics.closest_enu_m.tolist()))
        return self.metrics.summary(outcome, code, reason, now_s=now_s, stats=stats)
