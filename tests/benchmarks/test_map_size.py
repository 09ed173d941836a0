"""How long a step takes over a block, a town and a city: it must not matter.

A step is what the loop does for each position: way, observation and shield, and then a share of the
search for the next way; a round of the benchmark is 200 of them. Run with
``pytest tests/benchmarks --benchmark-only``.
"""

import time

import numpy as np
import pytest

from companion.guidance.guide import Guide
from companion.guidance.shield import Shield
from companion.guidance.shield_limits import ShieldLimits
from companion.policy.observation import WAYS, build_observation
from companion.world.maps import build_map
from companion.world.neighbourhood import Neighbourhood

PITCH_M = 36.0
STEPS = 200


def city_of(count):
    """Return a square city, and its middle: around that all of them are alike."""
    side = int(np.ceil(np.sqrt(count)))
    turn = 2.0 * np.pi * np.arange(12) / 12
    shapes = (
        np.array([(0, 0), (20, 0), (20, 8), (8, 8), (8, 20), (0, 20)], dtype=float),
        np.array([(0, 0), (20, 0), (20, 20), (0, 20)], dtype=float),
        10.0 + 10.0 * np.column_stack((np.cos(turn), np.sin(turn))),
    )
    east, north = np.divmod(np.arange(count), side) - np.array([[side // 2], [side // 2]])
    footprints = [
        shapes[(col - row) % 3] + PITCH_M * np.array([col + side // 2, row + side // 2]) + 8.0
        for col, row in zip(east, north, strict=True)
    ]
    heights_m = 15.0 + (7 * east + 11 * north) % 45
    size_m = (side * PITCH_M, side * PITCH_M, 100.0)
    return build_map("city", size_m, footprints, heights_m), PITCH_M * (side // 2)


@pytest.mark.benchmark(timer=time.process_time)
@pytest.mark.parametrize("count", [10, 300, 3000, 30_000])
def test_step(benchmark, count):
    city, middle_m = city_of(count)
    surroundings, shield = Neighbourhood(city), Shield(city, ShieldLimits())
    guide, target_m = Guide(city, WAYS), np.array([middle_m - 60.0, middle_m - 40.0, 20.0])
    # Down a street and back at 5 m/s and 20 Hz.
    along_m = middle_m - 0.25 * np.minimum(np.arange(STEPS), np.arange(STEPS)[::-1])
    places_m = np.column_stack((along_m, np.full(STEPS, middle_m), np.full(STEPS, 12.0)))
    velocity_mps = np.array([-4.0, 1.0, 0.0])

    def fly():
        for position_m in places_m:
            build_observation(
                WAYS,
                position_enu_m=position_m,
                velocity_enu_mps=velocity_mps,
                target_enu_m=target_m,
                map=surroundings.around(position_m),
                ahead=guide.ahead(position_m, target_m),
            )
            shield.check(velocity_mps, position_enu_m=position_m, velocity_now_enu_mps=velocity_mps)
            guide.work(position_m, target_m)

    benchmark(fly)
