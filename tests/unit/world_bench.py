"""A city of two obstacles and worlds on it, for the tests of ``sim.world``."""

import dataclasses
from dataclasses import fields

import numpy as np

from companion.policy.action import PAPER_SCALING
from companion.policy.observation import LAYOUTS
from companion.world.maps import build_map
from sim.world import CityWorld

TOWER_AND_COURT = build_map(
    "tower",
    [100, 100, 100],
    [
        [[40, 40], [60, 40], [60, 60], [40, 60]],
        [[70, 10], [95, 10], [95, 35], [88, 35], [88, 17], [77, 17], [77, 35], [70, 35]],
    ],
    [50, 80],
    obstacle_names=["tower", "court"],
    launch_enu_m=[5, 5, 0],
)
EAST = np.array([1.0, 0.0, -1.0])  # rho_max, horizontal, azimuth 0
NORTH = np.array([1.0, 0.0, -0.5])
UP = np.array([1.0, -1.0, -1.0])
STAY = np.array([-1.0, 0.0, 0.0])


def make_world(city, num_worlds=1, seed=0, layout="paper", scaling=PAPER_SCALING, **options):
    rng = np.random.default_rng(seed)
    return CityWorld(city, LAYOUTS[layout], scaling, num_worlds, rng, **options)


def without_noise(options):
    """Return options whose worlds draw nothing between two restarts and see where they are."""
    if "dynamics" not in options:
        return options
    still = dataclasses.replace(options["dynamics"], wind=None, position_noise=None)
    return options | {"dynamics": still}


def place(world, position_enu_m, target_enu_m):
    """Put every vehicle and its resting target somewhere."""
    state = world.state_dict()
    state["arrays"]["position_enu_m"][:] = position_enu_m
    state["arrays"]["target_enu_m"][:] = target_enu_m
    state["arrays"]["path_vertex_enu_m"][:] = target_enu_m
    world.load_state_dict(state)


def run(world, actions):
    return [world.step(action) for action in actions]


def random_actions(num_steps, num_worlds, seed=1):
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (num_steps, num_worlds, 3))


def assert_same(one, other):
    for field in fields(one):
        a, b = getattr(one, field.name), getattr(other, field.name)
        if field.name == "episode_end":
            assert_same(a, b)
        else:
            np.testing.assert_array_equal(a, b, err_msg=field.name)
