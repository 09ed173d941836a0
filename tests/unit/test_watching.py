"""What flight shows of the vehicle, put together."""

import dataclasses

import numpy as np

from companion.guidance.shield import Shield, ShieldLimits
from companion.policy.actor import Actor
from companion.positions import Pose
from companion.vehicle import FlightMode
from companion.watching import Watch
from companion.world.maps import load_map
from sim.vehicle import SimVehicle

FREE = load_map("free")


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
