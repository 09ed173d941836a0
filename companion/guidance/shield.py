"""The last check before the wire: a proposed velocity becomes a safe one, or a hold.

A velocity passes if the vehicle could follow it for one control period plus the reaction time and
then still stop, all without coming nearer than the margin to an obstacle or leaving the box. If
not, the nearest velocity that passes is flown instead: along the wall, round the corner, over the
roof, slower, or not at all. Inside the margin (a start beside a wall, a gust, an error of the
estimate) only velocities pass that lead out or, where nothing leads out, come no nearer.

Nearest counts a change of the vertical speed half: over a roof is a way, and slower is none. Where
more than half a margin is lost, or will be, what leads out comes first, and the proposal is heard
for 1 m/s beside it.

A drift that no command explains (``drift``) comes on top of every command, or ends at once: what
passes is safe either way, and what does not is leant against it. Where there were gusts, a vehicle
that needs longer to stop than the margin pays for starts to stop earlier. Between two walls nearer
than two margins it keeps to the middle.

The check is exact, not sampled: under the model a stop is a straight line, and obstacles, ground
and the faces of the box are convex bodies grown by the margin (``hazards``, ``braking``);
``nearest_safe`` searches what flies instead. It reads no clock, draws no random number and
remembers nothing but the map; what it should know of the past is in the drift that it is told.

========================  ==========================================================================
It assumes                What that means
========================  ==========================================================================
the map tells the truth   what is not on it does not exist
a vehicle as told         it follows within ``lag_s`` and brakes with ``brake_mps2``, or quicker; a
                          longer lag that is measured in flight is told (``envelope``)
to be asked and obeyed    every ``period_s``, within ``reaction_s``; what gets lost or comes late
                          (a fifth of all messages in the tests) is paid for by the margin
an estimate that is near  its error, that of the map and of the frame tie, and the size of the
                          vehicle: all of them are paid for by the margin, too
========================  ==========================================================================

========================  ==========================================================================
It does not cover         What happens
========================  ==========================================================================
what moves                other aircraft, cranes and people are not seen
wind beyond control       a drift is known once it is there: a gust of ``w`` that comes beside a
                          wall takes some ``lag_s * w`` of the margin; with air at 3 m/s and gusts
                          of 0.5 m/s (standard deviation) 2 m were enough; air that pushes harder
                          than ``brake_mps2`` takes the vehicle along
a place nobody knows      zero is sent where position or frame are in doubt; nothing leans against
                          the wind; after 5 s the autopilot's own hold takes over. Zero it is, too,
                          before the vehicle is ours, after a stall of the loop until it has looked,
                          and after an error of ours. All other holds go through the shield, and so
                          does a hand-over until the autopilot shows its own mode
the end of the stream     the autopilot flies on for a while (DESIGN 5.5): ``--cap-by-failsafe``
a wish into a wall        it does not plan: who wants straight through waits, ``BLOCKED``, maybe for
                          ever; the supervisor and the policy must find the way round
narrow streets            none narrower than two margins is entered; who is inside one may fly
                          along it, in the middle
========================  ==========================================================================
"""

import math
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
import numpy.typing as npt

from companion.arrays import FloatArray
from companion.guidance.braking import Braking
from companion.guidance.drift import CALM, Drift
from companion.guidance.hazards import Hazards, HazardSquares, Kind
from companion.guidance.nearest_safe import nearest_safe
from companion.guidance.scene import Scene
from companion.guidance.shield_limits import ShieldLimits
from companion.world.maps import Map
from companion.world.neighbourhood import Neighbourhood

_BLOCKED_SHARE = 0.1
"""A proposal of which less than this is left counts as blocked."""
_CHANGED_MPS = 1e-6
_BELIEVABLE = 1e5
"""No vehicle is farther from its map (m) than this, nor faster (m/s)."""
_INSIDE_M = 0.05
"""So little inside a margin goes without saying: a vehicle that slides along it wavers."""
_EMERGENCY_SHARE = 0.5
"""Of what is to be kept: losing more than this is an emergency."""
_EMERGENCY_MPS = 1.0
"""In an emergency no more than this of the proposal is heard, but for what leads out: what it
asks for along a wall is taken from the vehicle's acceleration away from it."""
_GUSTY = 1.25
"""A vehicle is expected no faster than this times its speed limit; it may be."""
_GUST_MPS = 1.0
"""No stronger gusts are expected; they may be."""
_ZERO: FloatArray = np.zeros(3)


class ShieldReason(StrEnum):
    """Why the velocity is what it is. The value is what the log and the viewer show."""

    CLEAR = ""
    """The proposal itself."""
    LIMITED = "speed limit"
    """Faster than allowed: slowed down, same direction."""
    OBSTACLE = "obstacle"
    GROUND = "ground"
    FENCE = "edge of the map"
    LEADING_OUT = "inside the margin"
    """Too near to an obstacle, to the ground or to the edge already: back, or no nearer."""
    BLOCKED = "blocked"
    """What is safe of the proposal is next to nothing; the vehicle waits. It may wait for ever:
    that is for the supervisor to notice."""
    EMERGENCY = "emergency"
    """Nothing keeps the margin; what keeps the most of it is flown."""
    NOT_FINITE = "proposal is not finite"
    """Not three finite numbers: taken as a hold."""
    STATE_INVALID = "state is not believable"
    """Position or velocity are not three numbers of any vehicle's: hold, nothing can be said."""


_REASONS = {
    Kind.OBSTACLE: ShieldReason.OBSTACLE,
    Kind.GROUND: ShieldReason.GROUND,
    Kind.FENCE: ShieldReason.FENCE,
}


@dataclass(frozen=True, slots=True)
class ShieldDecision:
    """What leaves, and why."""

    velocity_enu_mps: FloatArray
    """Always finite, shape ``(3,)``, within the limits."""
    intervened: bool
    """Whether it differs from the proposal."""
    reason: ShieldReason
    clearance_m: float
    """To the nearest obstacle or the ground, negative inside; NaN where the state is invalid."""


class Shield:
    """Keeps one vehicle on one map out of trouble.

    Args:
        city: The map.
        limits: What to keep.
    """

    def __init__(self, city: Map, limits: ShieldLimits) -> None:
        self._surroundings = Neighbourhood(city)
        self._hazards = Hazards.of_map(
            city, margin_m=limits.margin_m, min_height_m=limits.min_height_m
        )
        self._believe(limits)

    def reckon_with_lag(self, lag_s: float) -> None:
        """Believe from now on that the vehicle takes so long to follow: it was seen to.

        Args:
            lag_s: Time constant of the velocity loop; one that is no longer than ``lag_s`` of the
                limits is not believed.
        """
        if lag_s > self.limits.lag_s:
            self._believe(replace(self.limits, lag_s=lag_s))

    def _believe(self, limits: ShieldLimits) -> None:
        self.limits = limits
        self.braking = Braking(limits.lag_s, limits.brake_mps2)
        self._follow_s = limits.period_s + limits.reaction_s
        fastest_mps = max(limits.v_max_mps, limits.restore_max_mps)
        self._usual_reach_m = self._reach_m(_GUSTY * fastest_mps, _GUST_MPS)
        self._squares = HazardSquares(self._hazards, self._usual_reach_m)

    def check(
        self,
        velocity_enu_mps: npt.ArrayLike,
        *,
        position_enu_m: npt.ArrayLike,
        velocity_now_enu_mps: npt.ArrayLike,
        drift: Drift = CALM,
    ) -> ShieldDecision:
        """Return the velocity to send.

        Never raises, whatever the arguments hold.

        Args:
            velocity_enu_mps: The proposal, shape ``(3,)``.
            position_enu_m: Where the vehicle is estimated to be, shape ``(3,)``.
            velocity_now_enu_mps: What it is doing, shape ``(3,)``.
            drift: What no command explains of that.
        """
        position, velocity_now = _three(position_enu_m), _three(velocity_now_enu_mps)
        if position is None or velocity_now is None or not _believable(position, velocity_now):
            return ShieldDecision(np.zeros(3), True, ShieldReason.STATE_INVALID, float("nan"))
        given = _three(velocity_enu_mps)
        proposal = np.zeros(3) if given is None else self.limits.slowed(given)
        obstacles = self._surroundings.around(position).obstacles
        obstacle_m = float(obstacles.signed_distance_m(position))
        clearance_m = min(obstacle_m, float(position[2]))

        if obstacle_m < 0.0:
            chosen, reason = self._way_out(position), ShieldReason.EMERGENCY
        else:
            chosen, reason = self._safest(proposal, position, velocity_now, drift)
        if given is None:
            return ShieldDecision(chosen, True, ShieldReason.NOT_FINITE, clearance_m)
        changed = chosen is not given and bool(np.abs(chosen - given).max() > _CHANGED_MPS)
        if reason is ShieldReason.CLEAR and changed:
            reason = ShieldReason.LIMITED
        return ShieldDecision(chosen, changed, reason, clearance_m)

    def _safest(
        self,
        proposal: FloatArray,
        position: FloatArray,
        velocity_now: FloatArray,
        drift: Drift,
    ) -> tuple[FloatArray, ShieldReason]:
        """Return the velocity to fly outside all obstacles, and why."""
        # From here to the end velocities are over ground: the command, and the drift on top of it.
        drift_mps = drift.velocity_enu_mps
        wish = proposal + drift_mps
        scene = self._scene(wish, position, velocity_now, drift)
        if scene is None:
            return proposal, ShieldReason.CLEAR
        stops = scene.stops(np.stack((wish, _ZERO)))
        entered, entered_braking = stops.entered(scene.hazards.keep_m)
        if not entered.any():
            return proposal, ShieldReason.CLEAR

        slack_m = scene.slack_m
        if entered_braking.any():
            # What even braking loses cannot be asked for; it must be won back.
            slack_m = np.minimum(slack_m, stops.least_slack_m()[1])
        lost_m = np.maximum(-slack_m, 0.0)
        if lost_m.max() > _EMERGENCY_SHARE * self.limits.margin_m:
            out = scene.nearest_normal()[lost_m.argmax()]
            wish = _mostly_out(proposal, out) + drift_mps
            chosen = nearest_safe(wish, scene, lost_m, self.limits)
            return chosen - drift_mps, ShieldReason.EMERGENCY
        chosen = nearest_safe(wish, scene, lost_m, self.limits)
        if chosen @ chosen < _BLOCKED_SHARE**2 * (proposal @ proposal):
            return chosen - drift_mps, ShieldReason.BLOCKED
        return chosen - drift_mps, _reason(scene, entered)

    def _scene(
        self, wish: FloatArray, position: FloatArray, velocity_now: FloatArray, drift: Drift
    ) -> Scene | None:
        """Return what is within reach, ``None`` if nothing is."""
        square = max(float(wish @ wish), float(velocity_now @ velocity_now))
        fastest_mps = max(math.sqrt(square), self.limits.restore_max_mps)
        reach_m = self._reach_m(fastest_mps, drift.gust_mps)
        around = self._hazards if reach_m > self._usual_reach_m else self._squares.around(position)
        plane_m = around.plane_distance_m(position)
        near = plane_m.max(axis=1) - around.keep_m < reach_m
        if not near.any():
            return None
        return Scene(
            around.take(near), plane_m[near], velocity_now, drift, self.braking, self._follow_s
        )

    def _reach_m(self, fastest_mps: float, gust_mps: float) -> float:
        """Return how far a vehicle gets that follows a velocity a while and then stops."""
        return fastest_mps * self._follow_s + float(
            self.braking.stopping_distance_m(np.array(fastest_mps), gust_mps)
        )

    def _way_out(self, position: FloatArray) -> FloatArray:
        """Return the velocity to the nearest surface of the obstacle the vehicle is inside of."""
        obstacles = self._surroundings.around(position).obstacles
        way_m = obstacles.nearest_surface(position) - position
        way_m = way_m / max(float(np.sqrt(way_m @ way_m)), 1e-9)
        return self.limits.slowed(way_m * self.limits.restore_max_mps)


def _three(values: npt.ArrayLike) -> FloatArray | None:
    """Return three finite numbers as an array, or ``None`` for anything else."""
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        return None
    return array if array.shape == (3,) and all(map(math.isfinite, array.tolist())) else None


def _believable(position_enu_m: FloatArray, velocity_enu_mps: FloatArray) -> bool:
    return all(abs(x) < _BELIEVABLE for x in (*position_enu_m.tolist(), *velocity_enu_mps.tolist()))


def _mostly_out(velocity_mps: FloatArray, out: FloatArray) -> FloatArray:
    """Return what leads out of a velocity, and no more than a little of the rest."""
    leading_mps = max(0.0, float(velocity_mps @ out)) * out
    rest_mps = velocity_mps - float(velocity_mps @ out) * out
    length_mps = math.sqrt(float(rest_mps @ rest_mps))
    return leading_mps + rest_mps * min(1.0, _EMERGENCY_MPS / max(length_mps, _EMERGENCY_MPS))


def _reason(scene: Scene, entered: npt.NDArray[np.bool_]) -> ShieldReason:
    """Return why a proposal that would enter these hazards is not flown."""
    slack_m = scene.slack_m
    nearest = int(np.argmin(np.where(entered, slack_m, np.inf)))
    if slack_m[nearest] < -_INSIDE_M:
        return ShieldReason.LEADING_OUT
    return _REASONS[Kind(int(scene.hazards.kind[nearest]))]
