"""One instant as the shield sees it: what is near, and which velocities could still be stopped."""

from dataclasses import dataclass

import numpy as np

from companion.arrays import BoolArray, FloatArray
from companion.guidance.braking import Braking
from companion.guidance.candidates import MAX_WALLS
from companion.guidance.drift import Drift
from companion.guidance.hazards import Hazards, crossing

_TOUCH_M = 1e-3
"""Sliding exactly along the margin is not entering it."""
SAME_DIRECTION = 0.985
"""Cosine (10 degrees) above which two walls count as one."""
_SHARES = np.linspace(0.0, 1.0, 9)[:, None, None, None, None]


@dataclass(frozen=True, slots=True)
class Scene:
    """A vehicle and the hazards within its reach: ``B`` of them with up to ``F`` planes."""

    hazards: Hazards
    plane_m: FloatArray
    """Distance of the vehicle to every plane of each hazard, ``(B, F)``."""
    velocity_enu_mps: FloatArray
    drift: Drift
    braking: Braking
    follow_s: float
    """How long a velocity may be followed before the vehicle can be made to stop."""

    @property
    def slack_m(self) -> FloatArray:
        """Return how far the vehicle is outside every margin, ``(B,)``."""
        return np.asarray(self.plane_m.max(axis=1) - self.hazards.keep_m)

    def stops(self, velocity_enu_mps: FloatArray) -> "Stops":
        """Follow each velocity over ground, ``(K, 3)``, for a while, then stop."""
        drift_mps = self.drift.velocity_enu_mps
        begin_m, rest_m = self.braking.stopping_paths_m(
            self.velocity_enu_mps,
            velocity_enu_mps,
            follow_s=self.follow_s,
            drift_enu_mps=drift_mps if drift_mps.any() else None,
            gust_mps=self.drift.gust_mps,
        )
        ways_m = np.concatenate((begin_m, rest_m), axis=1)
        legs_m = ways_m.reshape(-1, 3) @ self.hazards.normal.reshape(-1, 3).T
        legs_m = legs_m.reshape(*ways_m.shape[:2], *self.plane_m.shape)
        return Stops(self.hazards.keep_m, self.plane_m, ways_m, legs_m)

    def walls(
        self, proposal_enu_mps: FloatArray, out_mps: FloatArray, lost: BoolArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return hazards as walls without end, those most in the way of the proposal first.

        A convex hazard lies behind any of its planes that the vehicle is in front of. Of these,
        the one is taken that asks least of the proposal.

        Args:
            proposal_enu_mps: Shape ``(3,)``.
            out_mps: Speed away that each hazard demands whose margin is lost, ``(B,)``.
            lost: Which those are, ``(B,)``.

        Returns:
            Unit normals away from the walls, ``(M, 3)``, and the least speed along each, ``(M,)``,
            negative where the vehicle may still approach; ``M <= MAX_WALLS``.
        """
        slack_m = self.plane_m - self.hazards.keep_m[:, None]
        nearest = slack_m == slack_m.max(axis=1, keepdims=True)
        approach_mps = self.approach_mps(slack_m)
        free = (slack_m >= 0.0) & ~lost[:, None]
        # Nothing is built on a drift that leads away: it may end at any moment.
        away_mps = np.maximum(self.hazards.normal @ self.drift.velocity_enu_mps, 0.0)
        least_mps = np.where(
            free, away_mps - approach_mps, np.where(nearest, out_mps[:, None], np.inf)
        )
        missing_mps = least_mps - self.hazards.normal @ proposal_enu_mps
        rows, plane = np.arange(len(slack_m)), np.argmin(missing_mps, axis=1)
        normal, least = self.hazards.normal[rows, plane], least_mps[rows, plane]
        order = np.argsort(-missing_mps[rows, plane], kind="stable")
        chosen = order[_distinct(normal[order])]
        return normal[chosen], least[chosen]

    def approach_mps(self, slack_m: FloatArray) -> FloatArray:
        """Return how fast a wall may be approached that is so far, shape as given."""
        return self.braking.approach_speed_mps(slack_m, self.follow_s, self.drift.gust_mps)

    def nearest_normal(self) -> FloatArray:
        """Return the normal of the plane that tells the distance of each hazard, ``(B, 3)``."""
        rows = np.arange(len(self.plane_m))
        return np.asarray(self.hazards.normal[rows, self.plane_m.argmax(axis=1)])


@dataclass(frozen=True, slots=True)
class Stops:
    """Ways to a stop after each of ``K`` velocities.

    Each at all ``P`` paces: where the stop begins, then where the vehicle comes to rest.
    """

    keep_m: FloatArray
    """Of every hazard, ``(B,)``."""
    plane_m: FloatArray
    """Distance of the start to every plane, ``(B, F)``."""
    ways_m: FloatArray
    """From the start, ``(K, 2 * P, 3)``."""
    legs_m: FloatArray
    """Gain of distance to every plane on these ways, ``(K, 2 * P, B, F)``."""

    def entered(self, grown_m: FloatArray) -> BoolArray:
        """Return which hazards, each grown by ``grown_m`` ``(B,)``, are entered, ``(K, B)``.

        Sliding along a hazard is not entering it.
        """
        outside_m = self.plane_m - (grown_m - _TOUCH_M)[:, None]
        # A plane with the whole way in front of it is an answer, and a quick one.
        nearest_m = outside_m + np.minimum(self.legs_m.min(axis=1), 0.0)
        entered: BoolArray = nearest_m.max(axis=-1) < 0.0
        unclear = np.flatnonzero(entered.any(axis=1))
        if len(unclear) > 0:
            start_m, change_m = _both_legs(outside_m, self.legs_m[unclear])
            entered[unclear] = crossing(start_m, change_m)[1].any(axis=1)
        return entered

    def least_slack_m(self) -> FloatArray:
        """Return the least slack on the way to each stop, ``(K, B)``.

        Inside a hazard itself every metre of the way counts: however thin it is, who goes
        deeper, or right through it, has lost more.
        """
        outside_m = self.plane_m - self.keep_m[:, None]
        start_m, change_m = _both_legs(outside_m, self.legs_m)
        slack_m = (start_m + _SHARES * change_m).max(axis=-1).min(axis=(0, 2))

        legs_m, paces = self.ways_m.copy(), self.ways_m.shape[1] // 2
        legs_m[:, paces:] -= legs_m[:, :paces]
        length_m = np.sqrt(np.einsum("kpi,kpi->kp", legs_m, legs_m))[..., None]
        before, entered = crossing(start_m + self.keep_m[:, None], change_m)
        within_m = np.where(entered, np.maximum(1.0 - before, 0.0) * length_m, 0.0)
        # Who enters before the stop begins is inside for all of the stop, come what may.
        first, later = within_m[:, :paces], within_m[:, paces:]
        later = np.where(entered[:, :paces], length_m[:, paces:], later)
        within_m = (first + later).max(axis=1)
        return np.asarray(np.where(entered.any(axis=1), -self.keep_m - within_m, slack_m))


def _both_legs(outside_m: FloatArray, legs_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return where both legs of each way start and how much they change, as ``legs_m``."""
    start_m, change_m, paces = np.empty_like(legs_m), legs_m.copy(), legs_m.shape[1] // 2
    start_m[:, :paces] = outside_m
    np.add(outside_m, legs_m[:, :paces], out=start_m[:, paces:])
    change_m[:, paces:] -= legs_m[:, :paces]
    return start_m, change_m


def _distinct(normal: FloatArray) -> list[int]:
    """Return the rows, at most ``MAX_WALLS``, that point nowhere an earlier one does."""
    alike = (normal @ normal.T > SAME_DIRECTION).tolist()
    chosen: list[int] = []
    for row, like in enumerate(alike):
        if len(chosen) < MAX_WALLS and not any(like[other] for other in chosen):
            chosen.append(row)
    return chosen
