"""Missions across towns larger than anything of the training, with the shipped actor."""

import numpy as np
import pytest

from companion.control import Flight, Mission
from companion.guidance.shield import Shield
from companion.guidance.shield_limits import ShieldLimits
from companion.guidance.situation import Plan
from companion.policy.actor import Actor
from companion.positions import TargetSource
from companion.world.frames import GeoPoint
from companion.world.maps import build_map
from sim.dynamics import VelocityLag
from sim.vehicle import SimVehicle

PITCH_M = 40.0
RATE_HZ = 10.0
V_MAX_MPS = 5.0


def town(side_m):
    """Return a square town of blocks, courts and towers, with streets of 16 m."""
    rng = np.random.default_rng(3)
    shapes = (
        np.array([(0, 0), (24, 0), (24, 24), (0, 24)], dtype=float),
        np.array([(0, 0), (24, 0), (24, 8), (8, 8), (8, 24), (0, 24)], dtype=float),
        np.array([(0, 0), (24, 0), (24, 24), (16, 24), (16, 8), (8, 8), (8, 24), (0, 24)]),
        np.array([(4, 4), (20, 4), (20, 20), (4, 20)], dtype=float),
    )
    rows = int(side_m / PITCH_M)
    footprints = [
        shapes[rng.integers(4)] + PITCH_M * np.array([east, north]) + 8.0
        for east in range(rows)
        for north in range(rows)
    ]
    heights_m = rng.uniform(8.0, 70.0, len(footprints))
    size_m, origin = (side_m, side_m, 100.0), GeoPoint(47.0, 8.0, 400.0)
    return build_map("town", size_m, footprints, heights_m, origin=origin)


@pytest.mark.parametrize(
    ("side_m", "start_m", "target_m"),
    [
        pytest.param(800.0, (82.0, 120.0, 15.0), (720.0, 640.0, 25.0), id="800 m"),
        pytest.param(
            2400.0, (82.0, 240.0, 15.0), (2200.0, 1800.0, 25.0), id="2.6 km", marks=pytest.mark.slow
        ),
    ],
)
def test_the_shipped_actor_crosses_a_town(side_m, start_m, target_m):
    city = town(side_m)
    distance_m = float(np.linalg.norm(np.subtract(target_m, start_m)))
    vehicle = SimVehicle(
        city,
        rng=np.random.default_rng(1),
        start_enu_m=np.array(start_m),
        airborne=True,
        lag=VelocityLag(0.6),
    )
    flight = Flight(
        vehicle,
        Mission(
            map=city,
            actor=Actor.load("flight"),
            plan=Plan(engage=True),
            target=TargetSource(np.array(target_m)),
            v_max_mps=V_MAX_MPS,
            rate_hz=RATE_HZ,
        ),
        Shield(city, ShieldLimits(v_max_mps=V_MAX_MPS, period_s=1.0 / RATE_HZ)),
        record=lambda _: None,
        stop_requested=lambda: vehicle.now_s() > 2.0 * distance_m / V_MAX_MPS + 30.0,
    )
    summary = flight.run()
    assert (summary.outcome, vehicle.contacts) == ("arrived", 0)
    assert summary.min_clearance_m is not None
    assert summary.min_clearance_m > 1.0
    assert summary.distance_flown_m < 1.5 * distance_m
