"""What an observation says in metres and metres a second: how fast, how narrow, how far in sight.

Training notes the range of each in the contract, flight compares (``guidance.envelope``). They are
read off the observation itself, so that both see the same. One ray says little of how dense a city
is, as every vehicle has been close to some wall: what it never was is between two of them.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from companion.arrays import FloatArray
from companion.policy.observation import (
    NUM_RAYS,
    RAYS_RANGE_M,
    RAYS_SPEED_MPS,
    WAYS_CLOSE_M,
    Layout,
)

MEASURES: Mapping[str, str] = MappingProxyType({"speed": "m/s", "gap": "m", "sight": "m"})
"""Names and units: the speed, the narrowest gap between walls on opposite sides of the vehicle,
and how far it sees on average."""


def _wall_m_of_closeness(closeness: FloatArray) -> FloatArray:
    away = np.maximum(1.0 - closeness, WAYS_CLOSE_M / (WAYS_CLOSE_M + RAYS_RANGE_M))
    return np.asarray(WAYS_CLOSE_M * closeness / away)


_WALL_M: Mapping[str, Callable[[FloatArray], FloatArray]] = MappingProxyType(
    {"rays": lambda share: RAYS_RANGE_M * share, "ways": _wall_m_of_closeness}
)
"""By layout: from the columns of the rays to distances, at most the range of the rays."""


def measures(layout: Layout, observation: npt.NDArray[np.floating]) -> dict[str, FloatArray]:
    """Return what there is of ``MEASURES`` in an observation; nothing where no rays are seen.

    Args:
        layout: Of the observation.
        observation: Shape ``(..., len(layout.fields))``.

    Returns:
        By name, each of shape ``(...)``.
    """
    wall_m_of = _WALL_M.get(layout.name)
    if wall_m_of is None:
        return {}
    columns = np.asarray(observation, dtype=np.float64)
    velocity, wall = layout.columns.index("velocity_ahead"), layout.columns.index("wall_00")
    velocity_mps = RAYS_SPEED_MPS * columns[..., velocity : velocity + 3]
    wall_m = wall_m_of(columns[..., wall : wall + NUM_RAYS])
    half = NUM_RAYS // 2
    return {
        "speed": np.sqrt(np.einsum("...i,...i->...", velocity_mps, velocity_mps)),
        "gap": (wall_m[..., :half] + wall_m[..., half:]).min(axis=-1),
        "sight": wall_m.mean(axis=-1),
    }
