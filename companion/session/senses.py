"""What the actor saw, as lines on the map again: rays that met a wall, and the way it was shown.

An observation is turned so that the target, or the next leg of the way, lies ahead; its columns
are found by their names, so that any layout with the same names is drawn. Pure; nothing here
knows Rerun.
"""

import math
from dataclasses import dataclass

import numpy as np

from companion.arrays import FloatArray
from companion.policy.observation import (
    NUM_RAYS,
    RAYS_RANGE_M,
    RAYS_UNIT_M,
    WAYS_CLOSE_M,
    WAYS_TURN_M,
)
from companion.session.records import Tick

_FREE = 0.999  # of the range: a ray that met nothing
_LEAST_M = 0.5  # a target straight above or below has no bearing


@dataclass(frozen=True)
class Seen:
    """What one observation tells, map ENU."""

    rays_m: FloatArray
    """From the vehicle to each wall that was met, shape ``(K, 2, 3)``."""
    way_m: FloatArray
    """Vehicle, aim, and where the way goes on from there, shape ``(3, 3)`` or ``(0, 3)``."""


class Senses:
    """Reads the observations of one layout."""

    def __init__(self, layout: str, columns: list[str]) -> None:
        """Find the columns by name."""
        places = {name: index for index, name in enumerate(columns)}
        walls = [places.get(f"wall_{ray:02d}") for ray in range(NUM_RAYS)]
        self._walls = [wall for wall in walls if wall is not None]
        self._closeness = layout == "ways"
        self._target = [places.get(f"target_{way}") for way in ("ahead", "left")]
        self._aim = [places.get(f"aim_{way}") for way in ("ahead", "up")]
        self._turn = [places.get(f"turn_{way}") for way in ("ahead", "left", "up")]

    @property
    def sees(self) -> bool:
        """Return whether there is anything to draw."""
        return len(self._walls) == NUM_RAYS

    def look(self, tick: Tick) -> Seen | None:
        """Return what the actor saw, ``None`` where it saw nothing or cannot be placed."""
        if not self.sees or tick.observation is None or tick.position_enu_m is None:
            return None
        observation = np.array(tick.observation)
        position_m = np.array(tick.position_enu_m)
        bearing_rad = self._bearing(tick, observation)
        if bearing_rad is None:
            return None
        walls = observation[self._walls]
        range_m = RAYS_RANGE_M * walls
        if self._closeness:
            range_m = WAYS_CLOSE_M * walls / np.maximum(1e-6, 1.0 - walls)
        met = range_m < _FREE * RAYS_RANGE_M
        angle_rad = bearing_rad + np.arange(NUM_RAYS) * (2.0 * np.pi / NUM_RAYS)
        ends_m = position_m + np.stack(
            (range_m * np.cos(angle_rad), range_m * np.sin(angle_rad), 0.0 * range_m), axis=-1
        )
        starts_m = np.broadcast_to(position_m, ends_m.shape)
        rays_m = np.stack((starts_m, ends_m), axis=1)[met]
        return Seen(rays_m, self._way(observation, position_m, bearing_rad))

    def _bearing(self, tick: Tick, observation: FloatArray) -> float | None:
        """Return the azimuth that lies ahead, from east toward north."""
        if tick.target_enu_m is None or tick.position_enu_m is None:
            return None
        east_m, north_m = np.subtract(tick.target_enu_m, tick.position_enu_m)[:2]
        if math.hypot(east_m, north_m) < _LEAST_M:
            return None
        to_target_rad = math.atan2(north_m, east_m)
        ahead, left = self._target
        if ahead is None or left is None:
            return to_target_rad
        return to_target_rad - math.atan2(observation[left], observation[ahead])

    def _way(
        self, observation: FloatArray, position_m: FloatArray, bearing_rad: float
    ) -> FloatArray:
        ahead, up = self._aim
        if ahead is None or up is None:
            return np.empty((0, 3))
        cos, sin = math.cos(bearing_rad), math.sin(bearing_rad)
        to_aim = np.array((cos * observation[ahead], sin * observation[ahead], observation[up]))
        aim_m = position_m + RAYS_UNIT_M * to_aim
        points = [position_m, aim_m]
        turns = [observation[column] for column in self._turn if column is not None]
        if len(turns) == len(self._turn):
            along, left, rise = turns
            turn = np.array((cos * along - sin * left, sin * along + cos * left, rise))
            points.append(aim_m + WAYS_TURN_M * turn)
        return np.array(points)
