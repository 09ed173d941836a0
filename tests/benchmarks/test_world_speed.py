"""How many steps a second the world takes on one core; ``pytest --benchmark-only``."""

import numpy as np
import pytest

from companion.policy.action import PAPER_SCALING, TARGET_SCALING
from companion.policy.observation import LAYOUTS
from companion.world.maps import load_map
from sim.cities import random_city
from sim.dynamics import VelocityLag
from sim.motion import Dynamics
from sim.world import CityWorld

NUM_WORLDS = 1024
MOVING = {"target_motion": "moving"}
FLIGHT = {"dynamics": Dynamics(lag=VelocityLag()), "end_on_contact": True}


def one(name):
    return lambda: load_map(name)


def many():
    return [random_city("training", number) for number in range(32)]


@pytest.mark.parametrize(
    ("maps", "layout", "options"),
    [
        pytest.param(one("free"), "paper", {}, id="free, paper"),
        pytest.param(one("env2"), "paper", {}, id="env2, paper"),
        pytest.param(one("env2"), "paper", MOVING, id="env2, moving target"),
        pytest.param(one("env2"), "relative", FLIGHT, id="env2, lag"),
        pytest.param(one("env2"), "rays", FLIGHT, id="env2, rays"),
        pytest.param(many, "paper", {}, id="32 cities, paper"),
        pytest.param(many, "rays", FLIGHT, id="32 cities, rays"),
        pytest.param(many, "ways", FLIGHT | {"targets_per_map": 8}, id="32 cities, ways"),
    ],
)
def test_world_speed(benchmark, maps, layout, options):
    scaling = PAPER_SCALING if layout == "paper" else TARGET_SCALING
    rng = np.random.default_rng(0)
    world = CityWorld(maps(), LAYOUTS[layout], scaling, NUM_WORLDS, rng, **options)
    action = rng.uniform(-1.0, 1.0, (64, NUM_WORLDS, 3))
    step = 0

    def one_step():
        nonlocal step
        world.step(action[step % 64])
        step += 1

    benchmark(one_step)
    benchmark.extra_info["steps_per_s"] = NUM_WORLDS / benchmark.stats.stats.median
