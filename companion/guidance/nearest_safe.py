"""The search of the shield: where a wish does not pass, the velocity nearest to it that does."""

import math
from collections.abc import Iterator

import numpy as np

from companion.arrays import BoolArray, FloatArray
from companion.guidance.candidates import fan, nearest_first, within_walls
from companion.guidance.demands import Demands, demands
from companion.guidance.scene import Scene
from companion.guidance.shield_limits import ShieldLimits

_ALIKE_M = 0.05
"""Where the margin is lost anyway: losses that differ by less count as equal."""
_ALIKE_MPS = 0.05
"""The same for speeds out of a margin."""
_FIRST = 4
"""Of the candidates, so many are looked at before all others."""


def nearest_safe(
    wish: FloatArray, scene: Scene, lost_m: FloatArray, limits: ShieldLimits
) -> FloatArray:
    """Return the velocity over ground nearest to a wish that passes, or else the least bad.

    Args:
        wish: Over ground. Does not pass itself, or may not.
        scene: What is near.
        lost_m: How much of each margin is lost even if the vehicle brakes now, ``(B,)``.
        limits: Of the shield.
    """
    normal = scene.nearest_normal()
    asked = demands(scene, lost_m, _out_mps(scene, lost_m, limits), alike_m=_ALIKE_M)
    missed: list[tuple[FloatArray, FloatArray, BoolArray]] = []
    for candidates in _candidates(wish, scene, asked, limits):
        stops = scene.stops(candidates)
        missing_mps = np.where(asked.lost, asked.out_mps - candidates @ normal.T, 0.0).max(axis=1)
        safe: BoolArray = np.logical_not(stops.entered(asked.bearable_m).any(axis=1))
        leads = safe & (missing_mps < _ALIKE_MPS)
        if leads.any():
            return np.asarray(candidates[leads.argmax()])
        missed.append((candidates, missing_mps, safe))

    candidates, missing_mps, safe = map(np.concatenate, zip(*missed, strict=True))
    if safe.any():
        # Between two walls: what gives way to both of them alike.
        candidates, missing_mps = candidates[safe], missing_mps[safe]
        gives = missing_mps < missing_mps.min() + _ALIKE_MPS
        return np.asarray(nearest_first(candidates[gives], wish)[0])
    least_m = scene.stops(candidates).least_slack_m().min(axis=1)
    least_bad = least_m > least_m.max() - _ALIKE_M
    return np.asarray(nearest_first(candidates[least_bad], wish)[0])


def _candidates(
    wish: FloatArray, scene: Scene, asked: Demands, limits: ShieldLimits
) -> Iterator[FloatArray]:
    """Return candidates, ``(K, 3)`` at a time, each time the nearest to the wish first."""
    exact = limits.slowed_over_ground(_within_walls(wish, scene, asked, limits), scene.drift)
    exact = nearest_first(exact, wish)
    yield exact[:_FIRST]
    if len(exact) > _FIRST:
        yield exact[_FIRST:]
    # Coarse and dear: only where no walls without end can be kept.
    coarse = limits.slowed_over_ground(fan(wish, limits.restore_max_mps), scene.drift)
    yield nearest_first(coarse, wish)


def _within_walls(
    wish: FloatArray, scene: Scene, asked: Demands, limits: ShieldLimits
) -> FloatArray:
    """Return a wish and what is nearest to it with regard to all walls, ``(n, 3)``."""
    fastest_mps = float(asked.out_mps.max())
    wishes = wish[None]
    if fastest_mps > 0.0:
        # The way out comes first: what it leaves of the speed limit is for the rest.
        share = math.sqrt(max(0.0, 1.0 - (fastest_mps / limits.v_max_mps) ** 2))
        wishes = np.array([[1.0], [share], [0.5 * share], [0.0]]) * wish
    found = within_walls(wishes, *scene.walls(wish, asked.out_mps, asked.lost))
    return np.concatenate((wish[None], found))


def _out_mps(scene: Scene, lost_m: FloatArray, limits: ShieldLimits) -> FloatArray:
    """Return the speed over ground with which to leave each margin that is lost, ``(B,)``."""
    if lost_m.max() == 0.0:
        return lost_m
    normal = scene.nearest_normal()
    wanted_mps = np.minimum(lost_m / limits.restore_s, limits.restore_max_mps)
    possible = limits.slowed_over_ground(normal * wanted_mps[:, None], scene.drift)
    return np.asarray(np.einsum("bi,bi->b", possible, normal))
