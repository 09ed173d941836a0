from types import SimpleNamespace

import numpy as np
import pytest

from companion.guidance.guidance import propose, straight_at_target_mps
from companion.policy.action import PAPER_SCALING, TARGET_SCALING
from companion.policy.observation import LAYOUTS, build_observation
from companion.world.maps import build_map
from companion.world.way_ahead import WayAhead

CITY = build_map("empty", (100, 100, 100), [], [])


class ConstantActor:
    """Answers the same action whatever it sees, and remembers what it saw."""

    def __init__(self, action, scaling, layout="paper"):
        self.contract = SimpleNamespace(layout=LAYOUTS[layout], action=scaling)
        self.answer = np.array(action, dtype=np.float32)
        self.saw = None

    def act(self, observation):
        self.saw = observation
        return self.answer


def ask(actor, position=(10.0, 20.0, 30.0), target=(40.0, 60.0, 30.0), ahead=None):
    return propose(
        actor,
        CITY,
        position_enu_m=np.array(position),
        velocity_enu_mps=np.zeros(3),
        target_enu_m=np.array(target),
        v_max_mps=5.0,
        ahead=ahead,
    )


@pytest.mark.parametrize(
    ("action", "expected"),
    [
        ([1, 0, -1], [5, 0, 0]),  # psi = 0: east
        ([1, 0, -0.5], [0, 5, 0]),  # psi = pi / 2: north
        ([0, 0, 0], [-2.5, 0, 0]),  # half of rho_max, psi = pi: west
        ([1, -1, 0], [0, 0, 5]),  # phi = 0: up
        ([1, 1, 0], [0, 0, -5]),  # phi = pi: down
        ([-1, 0, 0], [0, 0, 0]),
    ],
)
def test_an_action_becomes_a_velocity(action, expected):
    proposal = ask(ConstantActor(action, PAPER_SCALING))
    assert proposal.velocity_enu_mps == pytest.approx(expected, abs=1e-6)


def test_the_zero_action_measured_from_the_target_flies_straight_at_it():
    proposal = ask(ConstantActor([1, 0, 0], TARGET_SCALING))
    assert proposal.velocity_enu_mps == pytest.approx([3.0, 4.0, 0.0], abs=1e-6)
    rho, phi_rad, psi_rad = proposal.spherical
    assert rho == pytest.approx(0.2)
    assert phi_rad == pytest.approx(np.pi / 2)
    assert psi_rad == pytest.approx(np.arctan2(40.0, 30.0))


@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_actor_sees_what_it_was_trained_on(layout):
    actor = ConstantActor([0, 0, 0], PAPER_SCALING, layout)
    position, target = np.array([10.0, 20.0, 30.0]), np.array([40.0, 60.0, 30.0])
    ahead = WayAhead.straight(position, target) if LAYOUTS[layout].shows_way else None
    proposal = ask(actor, ahead=ahead)
    expected = build_observation(
        LAYOUTS[layout],
        position_enu_m=position,
        velocity_enu_mps=np.zeros(3),
        target_enu_m=target,
        map=CITY,
        ahead=ahead,
    )
    assert proposal.observation.tolist() == actor.saw.tolist() == expected.tolist()


def test_the_zero_action_of_an_actor_that_sees_the_way_flies_along_it():
    east, north = np.array([60.0, 20.0, 30.0]), np.array([10.0, 90.0, 30.0])
    ahead = WayAhead(east, north, np.array(150.0), np.array(True))
    proposal = ask(ConstantActor([1, 0, 0], TARGET_SCALING, "ways"), target=north, ahead=ahead)
    assert proposal.velocity_enu_mps == pytest.approx([5.0, 0.0, 0.0], abs=1e-6)


def test_an_actor_that_answers_nan_proposes_nan():
    proposal = ask(ConstantActor([np.nan, 0, 0], PAPER_SCALING))
    assert not np.isfinite(proposal.velocity_enu_mps).any()


def test_straight_at_the_target():
    here, there = np.zeros(3), np.array([3.0, 4.0, 0.0])
    assert straight_at_target_mps(here, there, 5.0).tolist() == [3.0, 4.0, 0.0]
    assert straight_at_target_mps(here, here, 5.0).tolist() == [0.0, 0.0, 0.0]
    many = straight_at_target_mps(np.zeros((7, 3)), there, 10.0)
    assert many.tolist() == [[6.0, 8.0, 0.0]] * 7
