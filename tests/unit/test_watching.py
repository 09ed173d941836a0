"""What flight shows of the vehicle, put together."""

import dataclasses

import numpy as np
import pytest

from companion.guidance.guidance import Proposal
from companion.guidance.shield import Shield
from companion.guidance.shield_limits import ShieldLimits
from companion.policy.actor import Actor
from companion.positions import Pose
from companion.vehicle import FlightMode, Severity
from companion.watching import Watch
from companion.world.maps import load_map
from sim.dynamics import VelocityLag, follow_velocity
from sim.vehicle import SimVehicle

FREE = load_map("free")
PERIOD_S = 0.05


def test_the_drift_is_expected_as_it_will_be_and_expecting_it_changes_nothing():
    rng = np.random.default_rng(0)
    state = SimVehicle(FREE, rng=rng, airborne=True).state()
    shield, contract = Shield(FREE, ShieldLimits()), Actor.load("flight").contract
    asked, left_alone = (Watch(shield, contract, 5.0, start_s=0.0) for _ in range(2))
    for tick in range(1, 50):
        pose = Pose(np.full(3, 50.0), rng.uniform(-3.0, 3.0, 3), 50.0)
        seen = dataclasses.replace(state, time_s=0.05 * tick, mode=FlightMode.EXTERNAL)
        expected = asked.expected_drift(seen, pose)
        for watch in (asked, left_alone):
            watch.before_sending(seen, pose)
            watch.sent(pose.velocity_enu_mps[::-1])
        assert asked.drift.same_as(expected)
        assert asked.drift.same_as(left_alone.drift)
        assert asked.expected_drift(seen, pose) is asked.drift, "nothing newer has come"


@pytest.mark.parametrize(
    ("lag_s", "severity", "advice"),
    [
        pytest.param(0.95, Severity.INFO, False, id="as proven"),
        pytest.param(2.0, Severity.WARNING, True, id="more than that"),
    ],
)
def test_a_lag_is_a_warning_only_beyond_what_the_shield_is_proven_on(lag_s, severity, advice):
    shield, contract = Shield(FREE, ShieldLimits()), Actor.load("flight").contract
    watch, velocity, said = Watch(shield, contract, 5.0, start_s=0.0), np.zeros(3), []
    proposal = Proposal(np.zeros(len(contract.layout.fields), np.float32), None, (), None)
    for tick in range(400):
        sent = np.array([3.0 if tick // 50 % 2 else -3.0, 0.0, 0.0])
        watch.sent(sent)
        pose = Pose(np.full(3, 50.0), velocity, 50.0)
        said += watch.after_sending(PERIOD_S * tick, None, pose, proposal)
        velocity, _ = follow_velocity(velocity, sent, VelocityLag(lag_s), dt_s=PERIOD_S)
    told = [(text, level) for text, level in said if text.startswith("the vehicle follows")]
    assert {level for _, level in told} == {severity}
    assert ("fly slower (--v-max)" in told[-1][0]) is advice
    assert shield.limits.lag_s > ShieldLimits().lag_s
