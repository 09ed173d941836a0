"""What the shipped actor does where flying straight at the target ends at a wall.

Each case is flown four times at once in the control loop, with lag, gusts and noise: alone, and
behind the shield.
"""

from dataclasses import dataclass

import numpy as np
import pytest

from companion.policy.actor import Actor
from companion.world.maps import build_map, load_map
from sim.dynamics import VelocityLag, VerticalLimits
from sim.guides import Surveyor
from sim.motion import Dynamics
from sim.targets import VERTICES, TargetPaths
from sim.world import CityWorld
from training.loop import RATE_HZ, Conditions, Guard

V_MAX_MPS = 5.0
FLIGHTS = 4
PATIENCE_S = 120.0
SIZE = (100.0, 100.0, 60.0)
SURVEYOR = Surveyor()

WALL = build_map("wall", SIZE, [[[48, 10], [52, 10], [52, 90], [48, 90]]], [60.0])
U_BLOCK = build_map(
    "u",
    SIZE,
    [[[40, 25], [70, 25], [70, 75], [40, 75], [40, 69], [64, 69], [64, 31], [40, 31]]],
    [60],
)
COURT = build_map(
    "court",
    SIZE,
    [
        [
            [35, 35],
            [65, 35],
            [65, 65],
            [41, 65],
            [41, 60],
            [59, 60],
            [59, 41],
            [41, 41],
            [41, 55],
            [35, 55],
        ]
    ],
    [40.0],
)
ROOF = build_map("roof", SIZE, [[[60, 40], [80, 40], [80, 60], [60, 60]]], [25.0])
GATE = build_map(
    "gate",
    SIZE,
    [[[48, 0], [52, 0], [52, 44], [48, 44]], [[48, 56], [52, 56], [52, 100], [48, 100]]],
    [60.0, 60.0],
)


@dataclass
class Flown:
    arrived: np.ndarray
    touched: np.ndarray


def fly(city, start, target, *, path=None, shield=False, calm=False):
    actor = Actor.load("flight")
    dynamics = Conditions().dynamics
    if calm:
        dynamics = Dynamics(lag=VelocityLag(), vertical=VerticalLimits())
    world = CityWorld(
        city,
        actor.contract.layout,
        actor.contract.action,
        FLIGHTS,
        np.random.default_rng(7),
        horizon=round(PATIENCE_S * RATE_HZ) + 1,
        target_motion="static" if path is None else "moving",
        v_max_mps=V_MAX_MPS,
        step_s=1.0 / RATE_HZ,
        dynamics=dynamics,
        surveyor=SURVEYOR,
    )
    state = world.state_dict()
    arrays = state["arrays"]
    arrays["position_enu_m"][:] = start
    arrays["velocity_enu_mps"][:] = 0.0
    arrays["target_enu_m"][:] = target
    if "led_to_enu_m" in arrays:
        arrays["led_to_enu_m"][:] = target
    vertices = np.array([target], dtype=np.float64)
    if path is not None:
        vertices = np.repeat(np.array([target, path], dtype=np.float64), (1, VERTICES - 1), axis=0)
    paths = TargetPaths.through(np.tile(vertices, (FLIGHTS, 1, 1)), np.full(FLIGHTS, 1.5))
    arrays["path_vertex_enu_m"][:] = paths.vertex_enu_m
    arrays["path_arc_m"][:] = paths.arc_m
    arrays["path_speed_mps"][:] = paths.speed_mps
    observation = world.load_state_dict(state)
    guard = Guard(world, V_MAX_MPS) if shield else None
    for _ in range(world.horizon - 1):
        action = actor.act(observation)
        result = world.step(action) if guard is None else world.follow(guard.check(world, action))
        observation = result.observation
        books = world.books()
        if (books.reached | books.contact_first).all():
            break
    return Flown(books.reached, books.contact_first)


CASES = {
    "target behind a wall": (WALL, (30, 50, 15), (70, 50, 15), {}),
    "target behind a block like a U": (U_BLOCK, (50, 50, 20), (85, 50, 20), {}),
    "start in a courtyard": (COURT, (50, 50, 5), (90, 20, 10), {}),
    "target on a roof": (ROOF, (20, 50, 5), (70, 50, 27.5), {}),
    "target goes through a gate": (GATE, (20, 20, 15), (60, 50, 15), {"path": (20, 50, 15)}),
    "zurich in calm air": (load_map("zurich"), (94, 96, 20), (30, 30, 15), {"calm": True}),
}


@pytest.mark.parametrize("case", CASES)
def test_alone_it_finds_its_way(case):
    city, start, target, options = CASES[case]
    flown = fly(city, start, target, **options)
    assert flown.arrived.sum() >= FLIGHTS - 1, case
    assert flown.touched.sum() <= 1, case


@pytest.mark.parametrize("case", CASES)
def test_behind_the_shield_it_arrives_and_touches_nothing(case):
    city, start, target, options = CASES[case]
    flown = fly(city, start, target, shield=True, **options)
    assert flown.arrived.all(), case
    assert not flown.touched.any(), case
