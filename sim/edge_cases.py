"""Where flights go wrong: a few hand-made places, each with a target and several starts.

Random cities hold all of this, but seldom and mixed; here a failure has a name.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.arrays import Float32Array, FloatArray
from companion.world.maps import Map, build_map
from sim.targets import TargetPaths
from sim.world import CityWorld

SIDE_M = 100.0
_TO_THE_CEILING_M = SIDE_M
_GATE_SPEED_MPS = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class EdgeCase:
    """One map, one target, and from where it is flown at."""

    name: str
    meaning: str
    """A sentence for people."""
    city: Map
    start_enu_m: FloatArray  # (K, 3)
    target: TargetPaths
    """Of one target; of one corner where it rests."""

    def begin(self, world: CityWorld) -> Float32Array:
        """Start the case in every world, from all starts in turn; return what is seen first."""
        turn = np.arange(world.num_worlds)
        start_enu_m = self.start_enu_m[turn % len(self.start_enu_m)]
        return world.place(start_enu_m, self.target.take(np.zeros_like(turn)))


def edge_cases() -> tuple[EdgeCase, ...]:
    """Return all of them."""
    return (
        _case(
            "behind a wall",
            "4 m behind a wall to the ceiling, which ends 15 m before either side of the map",
            [(_box(15, 48, 85, 52), _TO_THE_CEILING_M)],
            [
                (50, 20, 10),
                (50, 44, 10),
                (30, 35, 30),
                (75, 10, 5),
                (20, 42, 60),
                (60, 30, 90),
            ],
            (50, 56, 10),
        ),
        _case(
            "dead end",
            "behind the closed end of a U to the ceiling, flown at from inside and before it",
            [(_u_shape(30, 40, 70, 80, wing_m=6), _TO_THE_CEILING_M)],
            [
                (50, 60, 10),
                (40, 70, 20),
                (60, 68, 50),
                (50, 45, 5),
                (50, 15, 10),
                (45, 30, 70),
            ],
            (50, 90, 15),
        ),
        _case(
            "out of a court",
            "in the street, flown at from within a closed courtyard 20 m wide and 30 m deep",
            _court(),
            [(50, 50, 3), (44, 44, 3), (56, 44, 10), (50, 56, 20), (44, 56, 5), (56, 50, 27)],
            (50, 85, 5),
        ),
        _case(
            "into a court",
            "on the ground of that courtyard",
            _court(),
            [(50, 10, 5), (90, 50, 20), (10, 90, 40), (50, 85, 3), (25, 25, 10), (80, 80, 90)],
            (50, 50, 3),
        ),
        _case(
            "on a roof",
            "1 m above a roof at 60 m, between two towers that stand 30 m higher, 8 m away",
            [
                (_box(40, 40, 60, 60), 60.0),
                (_box(20, 35, 32, 65), 90.0),
                (_box(68, 35, 80, 65), 90.0),
            ],
            [(50, 10, 3), (50, 90, 30), (10, 50, 50), (90, 50, 5), (36, 30, 10), (64, 50, 40)],
            (50, 50, 61),
        ),
        _case(
            "through a gate",
            "moving at 2 m/s to and fro through a gap of 12 m in a wall from side to side",
            [
                (_box(0, 48, 44, 52), _TO_THE_CEILING_M),
                (_box(56, 48, 100, 52), _TO_THE_CEILING_M),
            ],
            [(50, 10, 10), (20, 40, 30), (80, 20, 60), (50, 90, 10), (20, 60, 5), (85, 85, 40)],
            (50, 25, 15),
            (50, 75, 15),
        ),
        _case(
            "beside a wall",
            "1 m from a wall of 60 m, nearer than the shield's margin, from all around",
            [(_box(40, 40, 60, 60), 60.0)],
            [(50, 10, 20), (50, 80, 20), (10, 50, 40), (90, 45, 5), (65, 39, 30), (30, 64, 80)],
            (50, 39, 20),
        ),
    )


def _case(
    name: str,
    meaning: str,
    buildings: Sequence[tuple[FloatArray, float]],
    starts: Sequence[tuple[float, float, float]],
    *target: tuple[float, float, float],
) -> EdgeCase:
    """Put a case together; a target of several corners moves from the first to the last."""
    city = build_map(
        name,
        [SIDE_M] * 3,
        [footprint_m for footprint_m, _ in buildings],
        [height_m for _, height_m in buildings],
        description=f"Edge case: the target is {meaning}.",
        launch_enu_m=(5.0, 5.0, 0.0),
    )
    corner_m = np.array([target], dtype=np.float64)
    paths = TargetPaths.resting(corner_m[:, 0])
    if len(target) > 1:
        paths = TargetPaths.through(corner_m, np.array([_GATE_SPEED_MPS]))
    return EdgeCase(name, meaning, city, np.array(starts, dtype=np.float64), paths)


def _box(west: float, south: float, east: float, north: float) -> FloatArray:
    return np.array(((west, south), (east, south), (east, north), (west, north)), dtype=np.float64)


def _u_shape(west: float, south: float, east: float, north: float, *, wing_m: float) -> FloatArray:
    """Three wings, open to the south."""
    return np.array(
        (
            (west, south),
            (west + wing_m, south),
            (west + wing_m, north - wing_m),
            (east - wing_m, north - wing_m),
            (east - wing_m, south),
            (east, south),
            (east, north),
            (west, north),
        ),
        dtype=np.float64,
    )


def _court() -> list[tuple[FloatArray, float]]:
    """Four wings around a courtyard of 20 m, closed all around."""
    return [(_u_shape(34, 40, 66, 66, wing_m=6), 30.0), (_box(34, 34, 66, 40), 30.0)]
