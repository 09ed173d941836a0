"""What lost margins ask for: how fast to get away from each wall, and where two of them agree."""

from dataclasses import dataclass

import numpy as np

from companion.arrays import BoolArray, FloatArray
from companion.guidance.scene import SAME_DIRECTION, Scene


@dataclass(frozen=True, slots=True)
class Demands:
    """Of every hazard, ``(B,)`` each."""

    lost: BoolArray
    """Whether its margin is, even if the vehicle brakes now."""
    out_mps: FloatArray
    """The speed away from it that is asked for, over ground; 0 where nothing is lost."""
    bearable_m: FloatArray
    """How near to it is not too near."""


def demands(scene: Scene, lost_m: FloatArray, out_mps: FloatArray, *, alike_m: float) -> Demands:
    """Return what the margins ask for together.

    A drift that leads away from a wall may end at any moment: the command alone must not lead
    toward it. Between two walls that face each other it is leant on, and neither is left faster
    than the other allows; where both margins are lost, the vehicle may come nearer to one until
    both losses are the same.

    Args:
        scene: What is near.
        lost_m: How much of each margin is lost, ``(B,)``.
        out_mps: The speed away that each asks for by itself, ``(B,)``.
        alike_m: Losses that differ by less count as equal.
    """
    lost, keep_m = lost_m > 0.0, scene.hazards.keep_m
    if not lost.any():
        return Demands(lost, lost_m, keep_m)
    normal = scene.nearest_normal()
    away_mps = np.maximum(normal @ scene.drift.velocity_enu_mps, 0.0)
    facing = normal @ normal.T < -SAME_DIRECTION
    between = (facing & lost).any(axis=1)
    out_mps = np.where(between, out_mps, np.maximum(out_mps, away_mps))

    # How much nearer the vehicle may come to one, that both losses be the same.
    both = facing & lost & lost[:, None]
    even_m = np.where(both, 0.5 * (lost_m[:, None] + lost_m), lost_m[:, None]).max(axis=1)
    slack_m = np.where(lost, even_m - lost_m, scene.slack_m)
    least_mps = np.where(lost, out_mps, away_mps - scene.approach_mps(slack_m))
    excess_mps = np.where(facing, np.maximum(least_mps[:, None] + least_mps, 0.0), 0.0)
    out_mps = out_mps - (excess_mps * np.where(lost, 0.5, 1.0)).max(axis=1)
    nearing_mps = np.where(between, scene.approach_mps(slack_m), np.inf)
    out_mps = np.maximum(out_mps, -nearing_mps)
    out_mps = np.minimum(out_mps, np.where(both, nearing_mps, np.inf).min(axis=1))
    leant_m = np.where(between, away_mps * (scene.follow_s + scene.braking.lag_s), 0.0)
    bearable_m = keep_m - np.where(lost, even_m + leant_m + alike_m, 0.0)
    return Demands(lost, np.where(lost, out_mps, 0.0), bearable_m)
