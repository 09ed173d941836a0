"""One instant as the shield sees it: what is near, and which velocities could still be stopped."""

from dataclasses import dataclass

import numpy as np

from companion.arrays import BoolArray, FloatArray
from companion.guidance.braking import PACES, Braking
from companion.guidance.candidates import MAX_WALLS
from companion.guidance.hazards import Hazards

_TOUCH_M = 1e-3
"""Sliding exactly along the margin is not entering it."""
_SAME_DIRECTION = 0.985
"""Cosine (10 degrees) above which two walls count as one."""
_LOSS_POINTS = 6


@dataclass(frozen=True, slots=True)
class Scene:
    """A vehicle and the hazards within its reach."""

    hazards: Hazards
    plane_m: FloatArray
    """Distance of the vehicle to every plane of each hazard, ``(B, F)``."""
    position_enu_m: FloatArray
    velocity_enu_mps: FloatArray
    braking: Braking
    follow_s: float
    """How long a velocity may be followed before the vehicle can be made to stop."""

    @property
    def slack_m(self) -> FloatArray:
        """Return how far the vehicle is outside every margin, ``(B,)``."""
        return np.asarray(self.plane_m.max(axis=1) - self.hazards.keep_m)

    def entered(self, velocity_enu_mps: FloatArray, grown_m: FloatArray) -> BoolArray:
        """Follow each velocity for a while, then stop; return which hazards would be entered.

        Args:
            velocity_enu_mps: Shape ``(K, 3)``.
            grown_m: By how much each hazard is grown, ``(B,)``.

        Returns:
            Shape ``(K, B)``. Sliding along a hazard is not entering it.
        """
        begin, rest = self._ways(velocity_enu_mps)
        start = np.broadcast_to(self.position_enu_m, begin.shape)
        ways = self.hazards.entered(
            np.concatenate((start, begin)).reshape(-1, 3),
            np.concatenate((begin, rest)).reshape(-1, 3),
            grown_m - _TOUCH_M,
        )
        return np.asarray(np.any(ways.reshape(2, -1, len(PACES), len(grown_m)), axis=(0, 2)))

    def least_slack_m(self, velocity_enu_mps: FloatArray) -> FloatArray:
        """Return the least slack on the way to a stop after each velocity, ``(K, B)``."""
        begin, rest = self._ways(velocity_enu_mps)
        slack_m = self.hazards.slack_m(begin.reshape(-1, 3), rest.reshape(-1, 3), _LOSS_POINTS)
        return np.asarray(slack_m.reshape(*begin.shape[:2], -1).min(axis=1))

    def walls(
        self, proposal_enu_mps: FloatArray, out_mps: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return hazards as walls without end, those most in the way of the proposal first.

        A convex hazard lies behind any of its planes that the vehicle is in front of. Of these,
        the one is taken that asks least of the proposal.

        Args:
            proposal_enu_mps: Shape ``(3,)``.
            out_mps: Speed away that each hazard demands, ``(B,)``; 0 where it demands none.

        Returns:
            Unit normals away from the walls, ``(M, 3)``, and the least speed along each, ``(M,)``,
            negative where the vehicle may still approach; ``M <= MAX_WALLS``.
        """
        slack_m = self.plane_m - self.hazards.keep_m[:, None]
        nearest = slack_m == slack_m.max(axis=1, keepdims=True)
        approach_mps = self.braking.approach_speed_mps(np.maximum(slack_m, 0.0), self.follow_s)
        free = (slack_m >= 0.0) & (out_mps == 0.0)[:, None]
        least_mps = np.where(free, -approach_mps, np.where(nearest, out_mps[:, None], np.inf))
        missing_mps = least_mps - self.hazards.normal @ proposal_enu_mps
        rows, plane = np.arange(len(slack_m)), np.argmin(missing_mps, axis=1)
        normal, least = self.hazards.normal[rows, plane], least_mps[rows, plane]
        order = np.argsort(-missing_mps[rows, plane], kind="stable")
        chosen = _distinct(normal[order])
        return normal[order][chosen], least[order][chosen]

    def nearest_normal(self) -> FloatArray:
        """Return the normal of the plane that tells the distance of each hazard, ``(B, 3)``."""
        rows = np.arange(len(self.plane_m))
        return np.asarray(self.hazards.normal[rows, self.plane_m.argmax(axis=1)])

    def _ways(self, velocity_enu_mps: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return where each stop begins and where it ends, ``(K, len(PACES), 3)`` each."""
        begin, rest = self.braking.stopping_paths_m(
            self.velocity_enu_mps, velocity_enu_mps, follow_s=self.follow_s
        )
        return self.position_enu_m + begin, self.position_enu_m + rest


def _distinct(normal: FloatArray) -> list[int]:
    """Return the rows, at most ``MAX_WALLS``, that point nowhere an earlier one does."""
    alike = normal @ normal.T > _SAME_DIRECTION
    chosen: list[int] = []
    for row in range(len(normal)):
        if len(chosen) < MAX_WALLS and not alike[row, chosen].any():
            chosen.append(row)
    return chosen
