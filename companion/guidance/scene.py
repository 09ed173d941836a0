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
_EMERGENCY_POINTS = 6


@dataclass(frozen=True, slots=True)
class Verdict:
    """What would come of each of ``K`` velocities."""

    entered: BoolArray
    """Which hazards could not be kept off as far as they are to be, ``(K, B)``."""
    leads_out: BoolArray
    """Keeps every margin, and leads out of those the vehicle is inside of, ``(K,)``."""
    keeps: BoolArray
    """Keeps every margin, and comes no nearer where the vehicle is inside of one, ``(K,)``."""


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
    out_mps: FloatArray
    """Speed with which it must leave each margin that it is inside of, ``(B,)``; else 0."""

    def judge(self, velocity_enu_mps: FloatArray) -> Verdict:
        """Follow each velocity for a while, then stop; see what would be entered.

        Args:
            velocity_enu_mps: Shape ``(K, 3)``.
        """
        distance_m, keep_m = self.plane_m.max(axis=1), self.hazards.keep_m
        stay_m = np.minimum(keep_m, distance_m) - _TOUCH_M
        leave_m = np.minimum(keep_m, distance_m + self.out_mps * self.follow_s) - _TOUCH_M
        begin, rest = self._ways(velocity_enu_mps)
        start = np.broadcast_to(self.position_enu_m, begin.shape)
        ways = self.hazards.entered(
            np.concatenate((start, begin)).reshape(-1, 3),
            np.concatenate((begin, rest)).reshape(-1, 3),
            stay_m,
        )
        entered = np.any(ways.reshape(2, -1, len(PACES), len(keep_m)), axis=(0, 2))
        keeps = ~np.any(entered, axis=1)
        if not self.out_mps.any():
            return Verdict(entered, keeps, keeps)
        entered = entered | self.hazards.entered(begin[:, -1], rest[:, -1], leave_m)
        return Verdict(entered, ~np.any(entered, axis=1), keeps)

    def least_slack_m(self, velocity_enu_mps: FloatArray) -> FloatArray:
        """Return the least distance beyond what is to be kept from each hazard, ``(K, B)``."""
        begin, rest = self._ways(velocity_enu_mps)
        slack_m = self.hazards.slack_m(begin.reshape(-1, 3), rest.reshape(-1, 3), _EMERGENCY_POINTS)
        return np.asarray(slack_m.reshape(*begin.shape[:2], -1).min(axis=1))

    def walls(self, proposal_enu_mps: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return hazards as walls without end, those most in the way of the proposal first.

        A convex hazard lies behind any of its planes that the vehicle is in front of. Of these,
        the one is taken that asks least of the proposal.

        Returns:
            Unit normals away from the walls, ``(M, 3)``, and the least speed along each, ``(M,)``,
            negative where the vehicle may still approach; ``M <= MAX_WALLS``.
        """
        keep_m = self.hazards.keep_m[:, None]
        nearest = self.plane_m == self.plane_m.max(axis=1, keepdims=True)
        approach_mps = self.braking.approach_speed_mps(
            np.maximum(self.plane_m - keep_m, 0.0), self.follow_s
        )
        least_mps = np.where(
            self.plane_m >= keep_m, -approach_mps, np.where(nearest, self.out_mps[:, None], np.inf)
        )
        missing_mps = least_mps - self.hazards.normal @ proposal_enu_mps
        rows, plane = np.arange(len(keep_m)), np.argmin(missing_mps, axis=1)
        normal, least = self.hazards.normal[rows, plane], least_mps[rows, plane]
        order = np.argsort(-missing_mps[rows, plane], kind="stable")
        chosen = _distinct(normal[order])
        return normal[order][chosen], least[order][chosen]

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
