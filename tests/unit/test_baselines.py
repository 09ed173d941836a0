"""The ceiling: shortest ways that are clear and short, and the flights along them."""

import numpy as np
import pytest

from companion.policy.action import PAPER_SCALING, TARGET_SCALING
from companion.policy.observation import LAYOUTS
from companion.world.maps import build_map, load_map
from sim.sampling import sample_free
from training.baselines import PlanAndTrack
from training.evaluate import fly_straight, paper_world
from training.flights import fly
from training.scenes import across, chase
from training.shortest_ways import ShortestWays, way_lengths_m

BLOCK = [[40, 20], [60, 20], [60, 80], [40, 80]]


@pytest.fixture(scope="module")
def find_ways():
    return ShortestWays()


@pytest.mark.parametrize("name", ["env1", "env2", "free"])
def test_ways_are_clear_and_hardly_longer_than_the_straight_line(find_ways, name):
    city = load_map(name)
    rng = np.random.default_rng(5)
    start_m, target_m = sample_free(city, rng, 150), sample_free(city, rng, 150)
    ways = find_ways(city, start_m, target_m)
    for way, start, target in zip(ways, start_m, target_m, strict=True):
        assert np.array_equal(way[[0, -1]], [start, target])
        assert (city.obstacles.crash_depth_m(way[:-1], way[1:]) == 0.0).all()
        assert city.contains(way).all()
    straight_m = np.linalg.norm(target_m - start_m, axis=1)
    stretch = way_lengths_m(ways) / straight_m
    assert (stretch >= 1.0 - 1e-12).all()
    assert stretch.mean() < 1.05


def test_a_wall_is_flown_round_or_over_whichever_is_shorter(find_ways):
    start_m, target_m = np.array([[30.0, 50.0, 10.0]]), np.array([[70.0, 50.0, 10.0]])
    high = build_map("high", [100, 100, 100], [BLOCK], [100.0])
    low = build_map("low", [100, 100, 100], [BLOCK], [20.0])
    (around,), (over,) = (find_ways(city, start_m, target_m) for city in (high, low))
    expected_m = 2 * np.hypot(10.0, 30.0) + 20.0
    assert way_lengths_m([around])[0] == pytest.approx(expected_m, rel=0.02)
    assert np.allclose(around[:, 2], 10.0, atol=5.0)
    expected_m = 2 * np.hypot(10.0, 10.0) + 20.0
    assert way_lengths_m([over])[0] == pytest.approx(expected_m, rel=0.04)


def test_no_way_into_a_closed_court_is_the_straight_line(find_ways):
    walls = [
        [[30, 30], [70, 30], [70, 35], [30, 35]],
        [[30, 65], [70, 65], [70, 70], [30, 70]],
        [[30, 34], [35, 34], [35, 66], [30, 66]],
        [[65, 34], [70, 34], [70, 66], [65, 66]],
    ]
    city = build_map("court", [100, 100, 100], walls, [100.0] * 4)
    start_m, target_m = np.array([[10.0, 10.0, 10.0]]), np.array([[50.0, 50.0, 10.0]])
    (way,) = find_ways(city, start_m, target_m)
    assert np.array_equal(way, np.stack((start_m[0], target_m[0])))


@pytest.mark.parametrize("scaling", [PAPER_SCALING, TARGET_SCALING])
def test_the_planner_completes_what_flying_straight_does_not(find_ways, scaling):
    def flown(policy, *, moving=False):
        cities = [load_map("env1"), load_map("env2")]
        world = paper_world(cities, LAYOUTS["paper"], scaling, episodes=120, seed=0, moving=moving)
        return fly(world, policy)

    planned, books = flown(PlanAndTrack(find_ways))
    assert books.reached.all()
    assert np.array_equal(books.reached, planned.reached)
    straight, _ = flown(fly_straight)
    assert 0.3 < straight.reached.mean() < 0.7
    moving, _ = flown(PlanAndTrack(find_ways), moving=True)
    assert moving.reached.mean() > 0.9
    assert not moving.contact.all()


def test_scenes_show_what_they_say(find_ways):
    city = load_map("env2")
    world = paper_world([city], LAYOUTS["paper"], PAPER_SCALING, episodes=200, seed=0)
    flights, _ = fly(world, PlanAndTrack(find_ways))
    scene = across(flights, city, "obs2", title="over obs2", over=True)
    shown = scene.flight.flight()
    assert shown.outcome == "reached"
    assert shown.distance_m[-1] < 5.0
    assert "of 200 test cases" in scene.choice
    tower = across(flights, city, "obs7", title="over obs7", over=True)
    assert tower.flight is None or tower.flight.flight().position_enu_m[:, 2].max() > 90.0

    world = paper_world([city], LAYOUTS["paper"], PAPER_SCALING, episodes=60, seed=0, moving=True)
    flights, _ = fly(world, PlanAndTrack(find_ways))
    moved = chase(flights, city, title="chase").flight.flight()
    assert np.linalg.norm(moved.target_enu_m[-1] - moved.target_enu_m[0]) > 0.0
    assert len(moved.position_enu_m) <= 21
