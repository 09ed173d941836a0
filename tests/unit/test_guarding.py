"""The guard: answers as the shield does, and asks it no more than needed."""

import numpy as np
import pytest

from companion.guarding import Guard
from companion.guidance.drift import CALM, Drift
from companion.guidance.shield import Shield
from companion.guidance.shield_limits import ShieldLimits
from companion.positions import Pose
from companion.world.maps import load_map

ENV1 = load_map("env1")
NORTH, EAST = np.array([0.0, 3.0, 0.0]), np.array([3.0, 0.0, 0.0])
HERE = Pose(np.array([10.0, 50.0, 20.0]), EAST, 20.0)


class CountingShield(Shield):
    def __init__(self):
        super().__init__(ENV1, ShieldLimits())
        self.asked = 0

    def check(self, *arguments, **options):
        self.asked += 1
        return super().check(*arguments, **options)


def test_the_same_is_not_asked_twice():
    shield = CountingShield()
    guard = Guard(shield)
    first = guard.check(NORTH, HERE, CALM)
    assert guard.check(NORTH.copy(), HERE, Drift(np.zeros(3), 0.0)) is first
    assert shield.asked == 1


@pytest.mark.parametrize(
    ("wanted", "pose", "drift"),
    [
        pytest.param(EAST, HERE, CALM, id="another wish"),
        pytest.param(np.full(3, np.nan), HERE, CALM, id="no wish at all"),
        pytest.param(NORTH, Pose(HERE.position_enu_m, NORTH, 20.0), CALM, id="another pose"),
        pytest.param(NORTH, HERE, Drift(0.5 * EAST, 1.5), id="another drift"),
        pytest.param(NORTH, HERE, Drift(np.zeros(3), 0.5), id="gusts of late"),
    ],
)
def test_what_is_new_is_asked(wanted, pose, drift):
    shield = CountingShield()
    guard = Guard(shield)
    guard.check(NORTH, HERE, CALM)
    answer = guard.check(wanted, pose, drift)
    assert shield.asked == 2
    fresh = Shield(ENV1, ShieldLimits()).check(
        wanted,
        position_enu_m=pose.position_enu_m,
        velocity_now_enu_mps=pose.velocity_enu_mps,
        drift=drift,
    )
    assert answer.reason is fresh.reason
    np.testing.assert_array_equal(answer.velocity_enu_mps, fresh.velocity_enu_mps)


def test_a_longer_lag_is_asked_about_anew():
    shield = CountingShield()
    guard = Guard(shield)
    guard.check(NORTH, HERE, CALM)
    shield.reckon_with_lag(2.0)
    guard.check(NORTH, HERE, CALM)
    assert shield.asked == 2
