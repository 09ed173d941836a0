"""How many steps a second the world takes on one core; ``pytest --benchmark-only``."""

import numpy as np
import pytest

from companion.policy.action import PAPER_SCALING, TARGET_SCALING
from companion.policy.observation import LAYOUTS
from companion.world.maps import load_map
from sim.dynamics import VelocityLag
from sim.world import CityWorld

NUM_WORLDS = 1024


@pytest.mark.parametrize(
    ("map_name", "layout", "options"),
    [
        pytest.param("free", "paper", {}, id="free, paper"),
        pytest.param("env2", "paper", {}, id="env2, paper"),
        pytest.param("env2", "paper", {"target_motion": "moving"}, id="env2, moving target"),
        pytest.param("env2", "relative", {"lag": VelocityLag()}, id="env2, lag"),
    ],
)
def test_world_speed(benchmark, map_name, layout, options):
    scaling = PAPER_SCALING if layout == "paper" else TARGET_SCALING
    rng = np.random.default_rng(0)
    world = CityWorld(load_map(map_name), LAYOUTS[layout], scaling, NUM_WORLDS, rng, **options)
    # Short steps, as a policy takes them near its target, keep vehicles in the middle of it.
    action = rng.uniform(-1.0, 1.0, (64, NUM_WORLDS, 3))
    step = 0

    def one_step():
        nonlocal step
        world.step(action[step % 64])
        step += 1

    benchmark(one_step)
    benchmark.extra_info["steps_per_s"] = NUM_WORLDS / benchmark.stats.stats.median
