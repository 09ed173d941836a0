"""A target kilometres away, brought as near as actors are used to.

They are trained on a hundred metres and their columns end at 150. A target beyond that is
replaced by a point on the straight way to it, which moves on with the vehicle.
"""

import numpy as np

from companion.arrays import FloatArray
from companion.world.way_ahead import WayAhead

HORIZON_M = 150.0
"""Level distance up to which a target is shown where it is: farther than any of the training."""
BROUGHT_TO_M = 90.0
"""How far a target beyond the horizon seems: actors fly more surely to it than to one at 140 m."""


def within_horizon(position_enu_m: FloatArray, target_enu_m: FloatArray) -> FloatArray:
    """Return the target, or a point on the straight way to one beyond the horizon, ``(..., 3)``.

    Args:
        position_enu_m: Of the vehicle, shape ``(..., 3)``.
        target_enu_m: Shape ``(..., 3)``.
    """
    way_m = target_enu_m - position_enu_m
    level_m = np.hypot(way_m[..., 0], way_m[..., 1])
    beyond = level_m > HORIZON_M
    if not beyond.any():
        return target_enu_m
    share = BROUGHT_TO_M / np.where(beyond, level_m, 1.0)
    return np.where(beyond[..., None], position_enu_m + share[..., None] * way_m, target_enu_m)


def way_within_horizon(
    position_enu_m: FloatArray, target_enu_m: FloatArray, way: WayAhead
) -> WayAhead:
    """Return the way ahead as if it ended at ``within_horizon``.

    What is left of it is shortened by as much as the target is nearer, so that what a way round
    costs remains.
    """
    near_m = within_horizon(position_enu_m, target_enu_m)
    if near_m is target_enu_m:
        return way
    nearer_m = _length_m(target_enu_m - position_enu_m) - _length_m(near_m - position_enu_m)
    return WayAhead(
        within_horizon(position_enu_m, way.aim_enu_m),
        within_horizon(position_enu_m, way.beyond_enu_m),
        way.left_m - nearer_m,
        way.known,
    )


def _length_m(way_m: FloatArray) -> FloatArray:
    length_m: FloatArray = np.sqrt(np.square(way_m).sum(axis=-1))
    return length_m
