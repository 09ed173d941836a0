"""Whole flights of the shipped actor on vehicles like those of its training, and unlike them."""

import numpy as np
import pytest

from companion.control import Flight, Mission
from companion.guidance.shield import Shield
from companion.guidance.shield_limits import ShieldLimits
from companion.guidance.situation import Plan
from companion.policy.actor import Actor
from companion.positions import TargetSource
from companion.session.records import Event, Tick
from companion.world.frames import GeoPoint
from companion.world.maps import build_map, load_map
from sim.dynamics import Disturbance, VelocityLag
from sim.vehicle import SimVehicle

V_MAX_MPS = 5.0
ORIGIN = GeoPoint(47.0, 8.0, 400.0)
GUSTS = Disturbance(0.3, 2.0)


class SteadyWind(Disturbance):
    """Blows to the east, and no autopilot leans against it."""

    def sample(self, rng, shape):
        return np.array([self.std, 0.0, 0.0])

    def advance(self, value, *, dt_s, rng):
        return value


def fly(city, start, target, *, lag=None, wind=GUSTS, seconds=120.0):
    """Return summary, events, ticks, vehicle and shield of one flight with the shipped actor."""
    vehicle = SimVehicle(
        city,
        rng=np.random.default_rng(3),
        start_enu_m=np.array(start),
        airborne=True,
        lag=lag,
        wind=wind,
        position_noise=Disturbance(0.2, 2.0),
    )
    actor = Actor.load("flight")
    records = []
    shield = Shield(city, ShieldLimits(v_max_mps=V_MAX_MPS))
    flight = Flight(
        vehicle,
        Mission(
            map=city,
            actor=actor,
            plan=Plan(engage=True),
            target=TargetSource(np.array(target)),
            v_max_mps=V_MAX_MPS,
            rate_hz=20.0,
        ),
        shield,
        record=records.append,
        stop_requested=lambda: vehicle.now_s() > seconds,
    )
    summary = flight.run()
    said = [record.text for record in records if isinstance(record, Event)]
    ticks = [record for record in records if isinstance(record, Tick)]
    return summary, said, ticks, vehicle, shield


@pytest.mark.parametrize(
    "lag",
    [
        pytest.param(VelocityLag(0.44, 1.6), id="ArduCopter as recorded"),
        pytest.param(VelocityLag(0.72, 2.5), id="PX4 as recorded"),
        pytest.param(VelocityLag(0.6, 4.0), id="brisk"),
    ],
)
def test_a_vehicle_like_those_of_training_flies_as_ever(lag):
    summary, said, ticks, vehicle, shield = fly(
        load_map("env1"), (10.0, 50.0, 20.0), (90.0, 50.0, 40.0), lag=lag
    )
    assert (summary.outcome, vehicle.contacts, summary.setpoints_slowed) == ("arrived", 0, 0)
    assert not any("training" in text for text in said)
    assert all(tick.speed_cap_mps is None for tick in ticks)
    # Of a sluggish vehicle a short flight does not tell whether it lags or just accelerates slowly.
    sluggish = lag.acceleration_max_mps2 < 4.0
    assert (sluggish and summary.velocity_lag_s is None) or 0.3 < summary.velocity_lag_s < 1.0
    assert shield.limits.lag_s == ShieldLimits().lag_s


def test_a_vehicle_that_lags_far_more_is_flown_slower_and_the_shield_told():
    summary, said, ticks, vehicle, shield = fly(
        load_map("env1"), (10.0, 50.0, 20.0), (90.0, 50.0, 40.0), lag=VelocityLag(1.8)
    )
    assert (summary.outcome, vehicle.contacts) == ("arrived", 0)
    assert summary.velocity_lag_s == pytest.approx(1.8, rel=0.35)
    assert shield.limits.lag_s >= 1.2
    (news,) = [text for text in said if text.startswith("not as in training")]
    assert "velocity lag" in news
    assert "(no more than 1 s in training)" in news
    (told, *_) = [text for text in said if text.startswith("the vehicle follows more slowly")]
    assert "not 0.8 s): the shield brakes earlier from now on" in told
    slowed = [tick for tick in ticks if tick.speed_cap_mps is not None]
    assert len(slowed) >= summary.setpoints_slowed > 20
    assert min(tick.speed_cap_mps for tick in slowed) < 0.75 * V_MAX_MPS


def block(west, south, east, north):
    return np.array([(west, south), (east, south), (east, north), (west, north)], dtype=float)


def test_in_streets_of_three_metres_it_goes_slower():
    """Nobody flies into one: it begins there, closer to both walls than the shield likes."""
    rows = [block(20, y, 97, y + 20) for y in (0, 23, 46, 69)]
    city = build_map("narrow", (200, 100, 60), rows, [50.0] * 4, origin=ORIGIN)
    narrow = fly(city, (40.0, 44.5, 10.0), (180.0, 44.5, 10.0), seconds=60.0)
    summary, said, ticks, vehicle, _ = narrow
    assert vehicle.contacts == 0
    (first, *_) = [text for text in said if text.startswith("not as in training")]
    assert "gap 3" in first
    assert min(tick.speed_cap_mps for tick in ticks if tick.speed_cap_mps) < 0.6 * V_MAX_MPS
    assert summary.setpoints_slowed > 0


def test_with_a_tailwind_it_flies_no_faster_over_ground_than_in_training():
    city = build_map("plain", (160, 100, 40), [], [], origin=ORIGIN)
    summary, said, ticks, _, _ = fly(
        city, (5.0, 50.0, 20.0), (155.0, 50.0, 20.0), wind=SteadyWind(3.0, 2.0)
    )
    assert summary.outcome == "arrived"
    (news,) = [text for text in said if text.startswith("not as in training")]
    assert "speed" in news
    fastest_mps = Actor.load("flight").contract.seen.measures["speed"][1]
    assert f"(no more than {fastest_mps:.2g} m/s in training)" in news
    speeds = [np.linalg.norm(tick.velocity_enu_mps) for tick in ticks if tick.safe_enu_mps]
    assert max(speeds) > 1.1 * fastest_mps
    assert np.median(speeds[-100:]) < 1.05 * fastest_mps
