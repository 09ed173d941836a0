"""Ways round obstacles, against a plain Dijkstra and the exact geometry."""

import heapq

import numpy as np
import pytest

from companion.world.maps import build_map, load_map
from companion.world.way_ahead import WayAhead, Ways
from companion.world.ways import CELL_M, HERE, MOVES, WayField, WayGrid, finish
from sim.cities import random_city
from sim.sampling import sample_free

SMALL = (30.0, 25.0, 20.0)
BLOCK = [[10, 5], [20, 5], [20, 20], [10, 20]]
FREE = build_map("free", (60, 60, 40), [], [])
THIN = build_map("thin", SMALL, [[[14, 0], [14.2, 0], [14.2, 20], [14, 20]]], [20.0])


def ways_to(city, target):
    grid = finish(WayGrid.build(city))
    field = finish(WayField.spread(grid, np.array(target, dtype=np.float64)))
    return grid, field, over(grid, field)


def over(grid, field):
    ways = Ways([grid], np.array([0]))
    ways.put(0, field)
    return ways


def ask(ways, positions, target) -> WayAhead:
    positions = np.atleast_2d(np.array(positions, dtype=np.float64))
    targets = np.broadcast_to(np.array(target, dtype=np.float64), positions.shape)
    return ways.ahead(np.zeros(len(positions), dtype=np.int64), positions, targets)


def moves_of(grid, cells):
    """Yield cost and ends of every move from some cells, read one by one."""
    for cell in cells:
        x, y, z = cell
        for east, north, up in MOVES[:HERE]:
            after = (x + east, y + north, z + up)
            if not all(0 <= index < size for index, size in zip(after, grid.shape, strict=True)):
                continue
            if east:
                cost = grid.east_cost[(east + 1) // 2, x, north + 1, up + 1, y, z]
            elif north:
                cost = grid.north_cost[(north + 1) // 2, y, up + 1, x, z]
            else:
                cost = grid.up_cost[(up + 1) // 2, z, x, y]
            yield cell, after, float(cost)


@pytest.mark.parametrize("city", [build_map("block", SMALL, [BLOCK], [12.0]), THIN])
def test_the_field_is_what_dijkstra_finds(city):
    target = np.array([26.0, 3.0, 4.0])
    grid, field, _ = ways_to(city, target)
    into = {}
    for cell, after, cost in moves_of(grid, np.ndindex(grid.shape)):
        into.setdefault(after, []).append((cell, cost))
    # Seeds: the cells that see the target keep a straight way.
    best = {
        cell: float(field.cost_m[cell])
        for cell in np.ndindex(grid.shape)
        if field.move[cell] == HERE and np.isfinite(field.cost_m[cell])
    }
    heap = [(cost, cell) for cell, cost in best.items()]
    heapq.heapify(heap)
    while heap:
        so_far, cell = heapq.heappop(heap)
        if so_far > best[cell]:
            continue
        for before, cost in into.get(cell, []):
            if so_far + cost < best.get(before, np.inf) - 1e-9:
                best[before] = so_far + cost
                heapq.heappush(heap, (so_far + cost, before))
    expected = np.full(grid.shape, np.inf)
    for cell, cost in best.items():
        expected[cell] = cost
    assert np.isinf(expected).any()
    np.testing.assert_allclose(field.cost_m.astype(float), expected, rtol=2e-3)


@pytest.mark.parametrize("city", [THIN, random_city("training", 5)])
def test_no_move_passes_through_an_obstacle(city):
    grid = finish(WayGrid.build(city))
    starts, ends = [], []
    cells = np.random.default_rng(0).integers(grid.shape, size=(400, 3))
    for cell, after, cost in moves_of(grid, map(tuple, cells)):
        if np.isfinite(cost):
            starts.append(cell)
            ends.append(after)
    start_m, end_m = grid.center_m(np.array(starts)), grid.center_m(np.array(ends))
    assert len(start_m) > 1000
    assert city.obstacles.crash_depth_m(start_m, end_m).max() == 0.0


@pytest.mark.parametrize("number", range(3))
def test_ways_arrive_and_touch_nothing(number):
    city = random_city("validation", number)
    rng = np.random.default_rng(number)
    target = sample_free(city, rng, 1)[0]
    _, _, ways = ways_to(city, target)
    position = sample_free(city, rng, 200, margin_m=2.0)
    ahead = ask(ways, position, target)
    assert ahead.known.all()
    for _ in range(45):
        ahead = ask(ways, position, target)
        assert (city.obstacles.crash_depth_m(position, ahead.aim_enu_m) == 0.0).mean() > 0.99
        way = ahead.aim_enu_m - position
        length = np.linalg.norm(way, axis=1, keepdims=True)
        after = position + way * np.minimum(1.0, 4.0 / np.maximum(length, 1e-9))
        assert (city.obstacles.crash_depth_m(position, after) == 0.0).all()
        position = after
    assert np.linalg.norm(position - target, axis=1).max() < 0.1


@pytest.mark.parametrize(("gap_m", "through"), [(3.0, False), (5.5, True)])
def test_a_gap_that_the_shield_forbids_is_not_the_way(gap_m, through):
    sides = ((0.0, 29.2), (29.2 + gap_m, 60.0))
    walls = [[[w, 20], [e, 20], [e, 30], [w, 30]] for w, e in sides]
    city = build_map("gap", (60, 60, 60), walls, [38.0, 38.0])
    target = np.array([31.0, 45.0, 6.0])
    _, _, ways = ways_to(city, target)
    here = np.array([[31.0, 8.0, 6.0]])
    highest_m = 0.0
    while (ahead := ask(ways, here, target)).aim_enu_m[0] != pytest.approx(target):
        here = ahead.aim_enu_m
        highest_m = max(highest_m, float(here[0, 2]))
    assert (highest_m < 20.0) == through
    assert through or highest_m > 38.0


def test_what_is_left_is_at_least_the_straight_way_and_falls():
    target = np.array([26.0, 3.0, 4.0])
    city = build_map("block", SMALL, [BLOCK], [12.0])
    _, _, ways = ways_to(city, target)
    position = sample_free(city, np.random.default_rng(1), 300)
    ahead = ask(ways, position, target)
    straight = np.linalg.norm(target - position, axis=1)
    assert (ahead.left_m >= straight - 0.1).all()
    lengths = ways.length_m(np.zeros(300, dtype=np.int64), position, np.tile(target, (300, 1)))
    assert (lengths >= straight - 1e-9).all()
    assert lengths.max() < 60.0


def test_a_target_in_sight_is_the_aim_and_its_way_is_straight():
    _, _, ways = ways_to(FREE, [50.0, 40.0, 10.0])
    ahead = ask(ways, [20.0, 25.0, 12.0], [50.0, 40.0, 10.0])
    assert ahead.aim_enu_m[0].tolist() == ahead.beyond_enu_m[0].tolist() == [50.0, 40.0, 10.0]
    assert ahead.left_m[0] == pytest.approx(np.linalg.norm([30.0, 15.0, 2.0]))


def test_the_way_round_a_wall_goes_to_its_end():
    _, _, ways = ways_to(THIN, [20.0, 5.0, 10.0])
    ahead = ask(ways, [8.0, 5.0, 10.0], [20.0, 5.0, 10.0])
    assert ahead.known[0]
    assert ahead.aim_enu_m[0, 1] > 20.0
    assert ahead.left_m[0] > 30.0


@pytest.mark.parametrize(
    "position", [(0.0, 0.0, 0.0), SMALL, (13.5, 10.0, 5.0), (14.1, 10.0, 5.0), (-3.0, 40.0, 50.0)]
)
def test_from_corners_walls_and_beyond_the_border_there_is_a_way(position):
    _, _, ways = ways_to(THIN, [20.0, 5.0, 10.0])
    ahead = ask(ways, position, [20.0, 5.0, 10.0])
    assert ahead.known[0]
    assert np.isfinite(ahead.aim_enu_m).all()
    if position == (13.5, 10.0, 5.0):
        assert ahead.aim_enu_m[0, 0] < 14.0, "it stays on its side of the wall"


@pytest.mark.parametrize("target", [(13.5, 10.0, 5.0), (14.6, 10.0, 0.2), (29.9, 24.9, 19.9)])
def test_targets_at_walls_and_borders_are_reached(target):
    _, _, ways = ways_to(THIN, target)
    ahead = ask(ways, [[5.0, 12.0, 3.0], [25.0, 12.0, 3.0]], target)
    assert ahead.known.all()


def test_a_target_shut_in_has_no_way():
    outer, inner = [[8, 8], [22, 8], [22, 9], [9, 9], [9, 19], [21, 19]], [[21, 9.5], [22, 9.5]]
    ring = [*outer, *inner, [22, 20], [8, 20]]
    lid = [[21, 8.5], [22, 8.5], [22, 10], [21, 10]]
    city = build_map("ring", SMALL, [ring, lid], [20.0, 20.0])
    _, _, ways = ways_to(city, [15.0, 14.0, 10.0])
    ahead = ask(ways, [[3.0, 3.0, 10.0], [12.0, 12.0, 5.0]], [15.0, 14.0, 10.0])
    assert ahead.known.tolist() == [False, True]
    assert ahead.aim_enu_m[0].tolist() == [15.0, 14.0, 10.0]
    assert ahead.left_m[0] == pytest.approx(np.linalg.norm([12.0, 11.0, 0.0]))
    start, target = np.array([[3.0, 3.0, 10.0]]), np.array([[15.0, 14.0, 10.0]])
    lengths = ways.length_m(np.array([0]), start, target)
    assert np.isinf(lengths[0])


def test_a_large_map_is_seen_through_a_window_that_makes_for_far_targets():
    wall = [[1000, 900], [1004, 900], [1004, 1040], [1000, 1040]]
    city = build_map("large", (2000, 2000, 60), [wall], [60.0])
    here, target = np.array([990.0, 1000.0, 20.0]), np.array([1900.0, 1000.0, 20.0])
    grid = finish(WayGrid.build(city, here))
    assert grid.shape[0] * CELL_M <= 160.0
    assert grid.holds(here)
    field = finish(WayField.spread(grid, target))
    ahead = ask(over(grid, field), here, target)
    assert ahead.known[0]
    assert city.obstacles.crash_depth_m(here, ahead.aim_enu_m[0]) == 0.0
    assert ahead.left_m[0] > 910.0


def test_rows_of_several_grids_and_fields_are_answered_as_alone():
    rng = np.random.default_rng(0)
    cities = [random_city("training", number) for number in range(3)]
    grids = [finish(WayGrid.build(city)) for city in cities]
    targets = np.concatenate([sample_free(city, rng, 2) for city in cities])
    grid_of_field = np.array([0, 0, 1, 1, 2, 2])
    fields = [
        finish(WayField.spread(grids[grid], target))
        for grid, target in zip(grid_of_field, targets, strict=True)
    ]
    ways = Ways(grids, grid_of_field)
    for number, field in enumerate(fields):
        ways.put(number, field)
    chosen = rng.integers(6, size=40)
    position = rng.uniform(0.0, 100.0, (40, 3))
    together = ways.ahead(chosen, position, targets[chosen])
    for row, field in enumerate(chosen):
        single = over(grids[grid_of_field[field]], fields[field])
        alone = ask(single, position[row], targets[field])
        np.testing.assert_array_equal(together.aim_enu_m[row], alone.aim_enu_m[0])
        np.testing.assert_array_equal(together.beyond_enu_m[row], alone.beyond_enu_m[0])
        assert together.left_m[row] == alone.left_m[0]


@pytest.mark.parametrize("name", ["env1", "free"])
def test_one_vehicle_is_told_the_same_to_the_last_bit(name):
    city, rng = load_map(name), np.random.default_rng(3)
    grid = finish(WayGrid.build(city))
    targets_m = rng.uniform(0.0, 1.0, (2, 3)) * city.size_m
    ways = Ways([grid], np.array([0, 0]))
    for number, target_m in enumerate(targets_m):
        ways.put(number, finish(WayField.spread(grid, target_m)))
    for _ in range(500):
        number = int(rng.integers(2))
        target_m = targets_m[number] + rng.normal(0.0, 1.0, 3)
        near = target_m + rng.normal(0.0, 6.0, 3)
        far = rng.uniform(-0.05, 1.05, 3) * city.size_m
        mad = np.where(rng.random(3) < 0.3, [np.nan, np.inf, -1e9], far)
        position_m = [near, far, far, far, mad][rng.integers(5)]
        one = ways.ahead_of_one(number, position_m, target_m)
        row = ways.ahead(np.array([number]), position_m[None], target_m[None]).take(0)
        assert one.known == row.known
        assert one.left_m.tobytes() == row.left_m.tobytes()
        assert one.aim_enu_m.tobytes() == row.aim_enu_m.tobytes()
        assert one.beyond_enu_m.tobytes() == row.beyond_enu_m.tobytes()
