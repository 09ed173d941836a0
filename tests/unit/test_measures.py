"""What is read off an observation in metres: the same from every layout, at every place."""

import numpy as np
import pytest

from companion.policy.contract import SeenContract
from companion.policy.measures import MEASURES, measures
from companion.policy.observation import PAPER, RAYS, RAYS_RANGE_M, WAYS, build_observation
from companion.world.maps import build_map
from companion.world.way_ahead import WayAhead


def block(west, east):
    return np.array([[west, 0.0], [east, 0.0], [east, 200.0], [west, 200.0]])


STREET = build_map("street", [200, 200, 50], [block(80, 97), block(100, 120)], [40.0, 40.0])
TARGET = np.array([98.5, 150.0, 10.0])


def see(layout, position, velocity=(0.0, 0.0, 0.0)):
    position = np.asarray(position, dtype=np.float64)
    target = np.broadcast_to(TARGET, position.shape)
    return build_observation(
        layout,
        position_enu_m=position,
        velocity_enu_mps=np.broadcast_to(np.asarray(velocity, dtype=np.float64), position.shape),
        target_enu_m=target,
        map=STREET,
        ahead=WayAhead.straight(position, target) if layout.shows_way else None,
    )


@pytest.mark.parametrize("layout", [RAYS, WAYS], ids=lambda layout: layout.name)
def test_speed_gap_and_sight_are_told_in_metres(layout):
    street = measures(layout, see(layout, [98.0, 100.0, 10.0], velocity=[3.0, 4.0, 1.0]))
    assert set(street) == set(MEASURES)
    assert street["speed"] == pytest.approx(np.sqrt(26.0), rel=1e-5)
    assert 3.0 <= street["gap"] < 3.1, "the street is 3 m wide, wherever in it; rays come in 15 deg"
    assert street["sight"] < 0.25 * RAYS_RANGE_M

    above = measures(layout, see(layout, [98.0, 100.0, 45.0]))
    assert above["gap"] == pytest.approx(2.0 * RAYS_RANGE_M, rel=1e-3)
    assert above["sight"] == pytest.approx(RAYS_RANGE_M, rel=1e-3)

    beside = measures(layout, see(layout, [79.0, 100.0, 10.0]))
    assert beside["gap"] > RAYS_RANGE_M, "close to one wall is not between two"


def test_batches_are_rows():
    places = np.array([[98.0, 100.0, 10.0], [30.0, 30.0, 20.0]])
    both = measures(WAYS, see(WAYS, places))
    for row, place in enumerate(places):
        alone = measures(WAYS, see(WAYS, place))
        for name, value in alone.items():
            assert both[name][row] == pytest.approx(value)


def test_who_sees_no_obstacles_measures_nothing():
    assert measures(PAPER, np.zeros(6)) == {}


def test_what_training_has_seen_leaves_out_a_thousandth_on_either_side():
    rng = np.random.default_rng(0)
    observations = rng.uniform(0.0, 1.0, (20_000, len(WAYS.fields))).astype(np.float32)
    seen = SeenContract.of(WAYS, observations)
    assert seen.observations == 20_000
    inside = np.array(seen.columns)
    shares = np.mean(observations < inside[:, 0], axis=0), np.mean(observations > inside[:, 1], 0)
    np.testing.assert_allclose(shares, seen.tail, atol=1e-4)
    for name, values in measures(WAYS, observations).items():
        low, high = seen.measures[name]
        assert np.mean((values < low) | (values > high)) == pytest.approx(0.002, abs=1e-4)
    assert SeenContract.of(WAYS, observations) == seen
