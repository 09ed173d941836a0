"""The way to the current target, found over ticks."""

import numpy as np
import pytest

from companion.guidance.guide import Guide
from companion.policy.observation import RAYS, WAYS
from companion.world.maps import build_map
from companion.world.ways import RENEW_M

WALL = [[48, 0], [52, 0], [52, 80], [48, 80]]
CITY = build_map("wall", (100, 100, 40), [WALL], [40.0])
TOWN = build_map("town", (400, 300, 30), [[[198, 0], [202, 0], [202, 170], [198, 170]]], [30.0])
WEST, EAST = np.array([40.0, 40.0, 10.0]), np.array([60.0, 40.0, 10.0])


def ticks(guide, position, target, count):
    return [(guide.ahead(position, target), guide.work(position, target))[0] for _ in range(count)]


def test_actors_that_do_not_see_the_way_are_not_kept_waiting_for_it():
    guide = Guide(CITY, RAYS)
    assert ticks(guide, WEST, EAST, 3) == [None] * 3


def test_until_it_is_found_the_way_is_straight_and_then_it_leads_round():
    seen = ticks(Guide(CITY, WAYS), WEST, EAST, 25)
    assert not seen[0].known
    assert seen[0].aim_enu_m.tolist() == EAST.tolist()
    assert seen[-1].known
    assert seen[-1].aim_enu_m[1] > 75.0
    assert seen[-1].aim_enu_m.shape == (3,)


def test_the_same_ticks_find_the_same_ways():
    first, again = (ticks(Guide(CITY, WAYS), WEST, EAST, 25) for _ in range(2))
    for one, other in zip(first, again, strict=True):
        np.testing.assert_array_equal(one.aim_enu_m, other.aim_enu_m)
        assert one.left_m == other.left_m


def test_a_target_that_moves_on_is_followed():
    guide = Guide(CITY, WAYS)
    ticks(guide, WEST, EAST, 25)
    target = EAST.copy()
    for _ in range(200):
        target = target + np.array([0.0, 0.1, 0.0])
        ahead = ticks(guide, WEST, target, 1)[0]
        assert ahead.known
    assert np.linalg.norm(ahead.beyond_enu_m - EAST) > RENEW_M


def test_a_target_that_jumps_is_straight_ahead_until_its_way_is_found():
    guide = Guide(CITY, WAYS)
    ticks(guide, WEST, EAST, 25)
    jumped = np.array([90.0, 20.0, 10.0])
    seen = ticks(guide, WEST, jumped, 40)
    assert not seen[0].known
    assert seen[0].aim_enu_m.tolist() == jumped.tolist()
    assert seen[-1].known


def test_on_a_town_the_window_goes_with_the_vehicle():
    guide = Guide(TOWN, WAYS)
    target = np.array([380.0, 120.0, 10.0])
    position = np.array([20.0, 120.0, 10.0])
    ticks(guide, position, target, 150)
    for _ in range(1000):
        ahead = ticks(guide, position, target, 1)[0]
        assert ahead.known
        way = ahead.aim_enu_m - position
        after = position + 0.5 * way / max(float(np.linalg.norm(way)), 0.5)
        assert TOWN.obstacles.crash_depth_m(position, after) == 0.0
        position = after
    assert np.linalg.norm(position - target) < 1.0


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_numbers_that_are_not_finite_end_nothing(bad):
    guide = Guide(CITY, WAYS)
    ticks(guide, WEST, EAST, 25)
    position = np.array([bad, 40.0, 10.0])
    assert ticks(guide, position, EAST, 2)[-1] is not None
