"""What the shipped actor does where flying straight at the target ends at a wall.

Each case is flown from three of its starts in the control loop: alone, and behind the shield.
"""

import numpy as np
import pytest

from companion.policy.actor import Actor
from companion.world.maps import load_map
from sim.dynamics import VelocityLag, VerticalLimits
from sim.edge_cases import EdgeCase, edge_cases
from sim.guides import Surveyor
from sim.motion import Dynamics
from sim.targets import TargetPaths
from training.loop import Conditions, evaluate_loop

FLIGHTS = 3
SURVEYOR = Surveyor()
GUSTY = Conditions()
CALM = Conditions(dynamics=Dynamics(lag=VelocityLag(), vertical=VerticalLimits()))
ZURICH = EdgeCase(
    "zurich in calm air",
    "where nothing shakes a vehicle out of a place where it hangs",
    load_map("zurich"),
    np.array([(94.0, 96.0, 20.0)]),
    TargetPaths.resting(np.array([(30.0, 30.0, 15.0)])),
)
CASES = [(case, GUSTY) for case in edge_cases()] + [(ZURICH, CALM)]
every_case = pytest.mark.parametrize(
    ("case", "conditions"), CASES, ids=[case.name for case, _ in CASES]
)


def fly(case, conditions, *, shield):
    actor = Actor.load("flight")
    return evaluate_loop(
        lambda _, observation: actor.act(observation),
        [case.city],
        actor.contract.layout,
        actor.contract.action,
        v_max_mps=5.0,
        episodes=FLIGHTS,
        seed=1,
        shield=shield,
        conditions=conditions,
        surveyor=SURVEYOR,
        begin=case.begin,
        now_s=lambda: 0.0,
    )


@every_case
def test_alone_it_finds_its_way(case, conditions):
    result = fly(case, conditions, shield=False)
    assert result.completion_rate * FLIGHTS >= FLIGHTS - 1
    assert result.collision_rate * FLIGHTS <= 1


@every_case
def test_behind_the_shield_it_arrives_and_touches_nothing(case, conditions):
    result = fly(case, conditions, shield=True)
    assert (result.completion_rate, result.collision_rate) == (1.0, 0.0)
