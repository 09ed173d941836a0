"""Crash depth and distances against shapely, and on the borders."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import assume, example, given
from hypothesis import strategies as st

from companion.world.decomposition import convex_pieces
from companion.world.geometry import Obstacles

SQUARE = np.array([[2.0, 2.0], [6.0, 2.0], [6.0, 6.0], [2.0, 6.0]])
L_SHAPE = np.array([[0.0, 0.0], [8.0, 0.0], [8.0, 3.0], [3.0, 3.0], [3.0, 9.0], [0.0, 9.0]])
U_SHAPE = np.array(
    [[0.0, 0.0], [9.0, 0.0], [9.0, 8.0], [6.0, 8.0], [6.0, 3.0], [3.0, 3.0], [3.0, 8.0], [0.0, 8.0]]
)
STAR = np.array(
    [
        [
            5.0 + (4.5 if k % 2 else 1.7) * math.sin(k * math.pi / 5),
            5.0 + (4.5 if k % 2 else 1.7) * math.cos(k * math.pi / 5),
        ]
        for k in range(10)
    ]
)
SHAPES = {"square": SQUARE, "L": L_SHAPE, "U": U_SHAPE, "star": STAR}
HEIGHT_M = 5.0


def oracle_depth_m(footprints, heights, start, end):
    """Length inside the union: cut the plan view at every roof crossing, ask shapely."""
    start, end = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
    length_m = float(np.linalg.norm(end - start))
    flat_m = float(np.linalg.norm(end[:2] - start[:2]))
    covered = []
    for footprint, height in zip(footprints, heights, strict=True):
        enter, leave = _below(start[2], end[2], height)
        if enter >= leave:
            continue
        polygon = shapely.Polygon(footprint)
        if flat_m == 0.0:
            if polygon.covers(shapely.Point(start[:2])):
                covered.append((enter, leave))
            continue
        line = shapely.LineString([start[:2], end[:2]])
        for part in getattr(polygon.intersection(line), "geoms", [polygon.intersection(line)]):
            if part.geom_type == "LineString" and not part.is_empty:
                ends = [
                    float(np.linalg.norm(np.array(corner) - start[:2])) / flat_m
                    for corner in (part.coords[0], part.coords[-1])
                ]
                covered.append((max(enter, min(ends)), min(leave, max(ends))))
    total = reached = 0.0
    for enter, leave in sorted(covered):
        total += max(0.0, leave - max(enter, reached))
        reached = max(reached, leave)
    return total * length_m


def _below(start_z, end_z, height):
    """Fractions of a segment between which it is at or below a height."""
    if start_z <= height and end_z <= height:
        return 0.0, 1.0
    if start_z > height and end_z > height:
        return 1.0, 0.0
    crossing = (height - start_z) / (end_z - start_z)
    return (0.0, crossing) if start_z <= height else (crossing, 1.0)


def oracle_distance_m(footprint, height, point):
    polygon, place = shapely.Polygon(footprint), shapely.Point(point[:2])
    beside = polygon.exterior.distance(place)
    if polygon.covers(place):
        above = point[2] - height
        return above if above > 0.0 else -min(beside, -above)
    return math.hypot(beside, max(0.0, point[2] - height))


coordinates = st.floats(-3.0, 13.0, width=32)
grid = st.integers(-2, 12).map(float)  # hits corners, walls and roofs
points = st.tuples(coordinates, coordinates, coordinates)
grid_points = st.tuples(grid, grid, grid)
shapes = st.sampled_from(sorted(SHAPES))


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("turned", [False, True])
def test_pieces_are_convex_and_add_up(name, turned):
    footprint = SHAPES[name][::-1] if turned else SHAPES[name]
    pieces = [shapely.Polygon(piece) for piece in convex_pieces(footprint)]
    whole = shapely.Polygon(footprint)
    assert sum(piece.area for piece in pieces) == pytest.approx(whole.area)
    assert shapely.union_all(pieces).symmetric_difference(whole).area == pytest.approx(0.0)
    for piece in pieces:
        assert piece.exterior.is_ccw
        assert piece.convex_hull.area == pytest.approx(piece.area)


def test_pieces_are_few():
    assert [len(convex_pieces(SHAPES[name])) for name in ("square", "L", "U")] == [1, 2, 3]
    assert len(convex_pieces(STAR)) <= 11  # two for each of the five reflex corners, and one


@pytest.mark.parametrize("seed", range(40))
def test_pieces_of_random_polygons_add_up(random_city, seed):
    for footprint in random_city(seed)[0]:
        pieces = [shapely.Polygon(piece) for piece in convex_pieces(footprint)]
        assert sum(p.area for p in pieces) == pytest.approx(shapely.Polygon(footprint).area)


@given(shapes, points, points)
def test_depth_agrees_with_shapely(name, start, end):
    footprint = SHAPES[name]
    depth = Obstacles([footprint], [HEIGHT_M]).crash_depth_m(np.array(start), np.array(end))
    assert depth == pytest.approx(oracle_depth_m([footprint], [HEIGHT_M], start, end), abs=1e-6)


@given(st.sampled_from(["square", "L", "U"]), grid_points, grid_points)
@example("L", (3.0, -1.0, 0.0), (3.0, 12.0, 0.0))  # along a seam, then along a wall
@example("square", (2.0, 0.0, 1.0), (2.0, 9.0, 1.0))  # grazes a wall
@example("square", (0.0, 3.0, 5.0), (9.0, 3.0, 5.0))  # grazes the roof
def test_depth_agrees_with_shapely_on_the_grid(name, start, end):
    """Closed sets: here nearly every case starts on, ends on or slides along a face."""
    footprint = SHAPES[name]
    depth = Obstacles([footprint], [HEIGHT_M]).crash_depth_m(np.array(start), np.array(end))
    assert depth == pytest.approx(oracle_depth_m([footprint], [HEIGHT_M], start, end), abs=1e-9)


@pytest.mark.parametrize("seed", range(20))
def test_depth_in_overlapping_cities_agrees_with_shapely(random_city, seed):
    footprints, heights = random_city(seed)
    rng = np.random.default_rng(1000 + seed)
    start, end = rng.uniform(0.0, 100.0, (2, 150, 3))
    end[::5, :2] = start[::5, :2]  # vertical moves
    end[1::5, 2] = start[1::5, 2]  # level moves
    depth = Obstacles(footprints, heights).crash_depth_m(start, end)
    expected = [oracle_depth_m(footprints, heights, *pair) for pair in zip(start, end, strict=True)]
    np.testing.assert_allclose(depth, expected, atol=1e-6)
    assert (depth > 0.0).sum() > 20


@pytest.mark.parametrize(
    ("start", "end", "depth"),
    [
        pytest.param([0, 4, 3], [10, 4, 3], 4.0, id="through"),
        pytest.param([3, 4, 3], [5, 4, 3], 2.0, id="inside all the way"),
        pytest.param([3, 4, 3], [10, 4, 3], 3.0, id="out of it"),
        pytest.param([2, 4, 3], [10, 4, 3], 4.0, id="starts on a wall, inward"),
        pytest.param([2, 4, 3], [0, 4, 3], 0.0, id="starts on a wall, outward"),
        pytest.param([2, 2, 3], [0, 0, 3], 0.0, id="starts on an edge, outward"),
        pytest.param([2, 0, 3], [2, 10, 3], 4.0, id="slides along a wall"),
        pytest.param([2 - 1e-9, 0, 3], [2 - 1e-9, 10, 3], 0.0, id="just beside a wall"),
        pytest.param([0, 4, 5], [10, 4, 5], 4.0, id="slides over the roof"),
        pytest.param([0, 4, 5 + 1e-9], [10, 4, 5 + 1e-9], 0.0, id="just over the roof"),
        pytest.param([0, 0, 3], [4, 0, 3], 0.0, id="passes by"),
        pytest.param([0, 4, 3], [4, 0, 3], 0.0, id="touches an edge"),
        pytest.param([4, 4, 0], [4, 4, 10], 5.0, id="vertical, up"),
        pytest.param([4, 4, 10], [4, 4, 0], 5.0, id="vertical, down"),
        pytest.param([2, 4, 10], [2, 4, 0], 5.0, id="down along a wall"),
        pytest.param([1, 4, 10], [1, 4, 0], 0.0, id="vertical, beside"),
        pytest.param([4, 4, 10], [4, 4, 5], 0.0, id="lands on the roof"),
        pytest.param([4, 4, 3], [4, 4, 3], 0.0, id="no move, inside"),
        pytest.param([2, 4, 3], [2, 4, 3], 0.0, id="no move, on a wall"),
        pytest.param([0, 4, -1], [10, 4, -1], 4.0, id="below ground"),
        pytest.param([0, 4, 3], [0, 4, 3], 0.0, id="no move, outside"),
        pytest.param([4, 0, 10], [4, 8, 0], math.sqrt(164) * 0.25, id="dives through the roof"),
    ],
)
def test_depth_on_the_borders(start, end, depth):
    obstacles = Obstacles([SQUARE], [HEIGHT_M])
    assert obstacles.crash_depth_m(np.array(start), np.array(end)) == pytest.approx(depth)


@pytest.mark.parametrize("seed", range(10))
def test_nothing_slips_along_a_seam_between_pieces(seed):
    """Flying along a slanted cut through a concave obstacle is inside all the way."""
    rng = np.random.default_rng(seed)
    turn = rng.uniform(0.0, 2.0 * math.pi)
    rotation = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    footprint = U_SHAPE @ rotation.T
    pieces = convex_pieces(footprint)
    obstacles = Obstacles([footprint], [HEIGHT_M])
    corners = [
        (a, b) for piece in pieces for a, b in zip(piece, np.roll(piece, -1, 0), strict=True)
    ]
    whole = shapely.Polygon(footprint)
    for first, second in corners:
        middle = shapely.Point(0.5 * (first + second))
        if whole.exterior.distance(middle) > 0.1:
            start, end = np.append(first, 1.0), np.append(second, 1.0)
            length = float(np.linalg.norm(end - start))
            assert obstacles.crash_depth_m(start, end) == pytest.approx(length)


def test_overlaps_count_once():
    twice = Obstacles([SQUARE, SQUARE + 1.0, SQUARE[::-1]], [HEIGHT_M, HEIGHT_M, 2.0])
    assert twice.crash_depth_m(np.array([0.0, 4.0, 1.0]), np.array([9.0, 4.0, 1.0])) == 5.0


@given(shapes, points, points)
def test_depth_is_symmetric_and_within_the_way(name, start, end):
    obstacles = Obstacles([SHAPES[name]], [HEIGHT_M])
    start, end = np.array(start), np.array(end)
    depth = obstacles.crash_depth_m(start, end)
    assert 0.0 <= depth <= np.linalg.norm(end - start) * (1.0 + 1e-12)
    assert depth == pytest.approx(obstacles.crash_depth_m(end, start), abs=1e-9)


@given(shapes, points, points, st.floats(0.0, 1.0))
def test_depth_of_the_parts_is_the_depth_of_the_whole(name, start, end, fraction):
    obstacles = Obstacles([SHAPES[name]], [HEIGHT_M])
    start, end = np.array(start), np.array(end)
    between = start + fraction * (end - start)
    parts = obstacles.crash_depth_m(start, between) + obstacles.crash_depth_m(between, end)
    assert parts == pytest.approx(obstacles.crash_depth_m(start, end), abs=1e-6)


@pytest.mark.parametrize("seed", range(20))
def test_signed_distance_agrees_with_shapely(random_city, seed):
    footprints, heights = random_city(seed)
    point = np.random.default_rng(seed).uniform(-20.0, 120.0, (300, 3))
    expected = [
        min(oracle_distance_m(f, h, p) for f, h in zip(footprints, heights, strict=True))
        for p in point
    ]
    obstacles = Obstacles(footprints, heights)
    np.testing.assert_allclose(obstacles.signed_distance_m(point), expected, atol=1e-9)
    np.testing.assert_array_equal(obstacles.contains(point), np.array(expected) <= 0.0)


@given(st.sampled_from(["square", "L", "U"]), grid_points)
def test_signed_distance_agrees_with_shapely_on_the_grid(name, point):
    obstacles = Obstacles([SHAPES[name]], [HEIGHT_M])
    expected = oracle_distance_m(SHAPES[name], HEIGHT_M, point)
    assert obstacles.signed_distance_m(np.array(point)) == pytest.approx(expected, abs=1e-12)
    assert obstacles.contains(np.array(point)) == (expected <= 0.0)


@pytest.mark.parametrize(
    ("point", "distance", "nearest"),
    [
        pytest.param([0, 4, 3], 2.0, [2, 4, 3], id="wall"),
        pytest.param([-1, -2, 3], 5.0, [2, 2, 3], id="edge"),
        pytest.param([4, 4, 9], 4.0, [4, 4, 5], id="roof"),
        pytest.param([-1, 4, 9], 5.0, [2, 4, 5], id="roof edge"),
        pytest.param([0, 0, 6], 3.0, [2, 2, 5], id="roof corner"),
        pytest.param([3, 4, 2], -1.0, [2, 4, 2], id="inside, wall"),
        pytest.param([4, 4, 4], -1.0, [4, 4, 5], id="inside, roof"),
        pytest.param([4, 3.5, 0], -1.5, [4, 2, 0], id="inside, on the ground: no bottom face"),
        pytest.param([0, 4, -3], 2.0, [2, 4, -3], id="below ground, walls go on"),
        pytest.param([2, 4, 3], 0.0, [2, 4, 3], id="on a wall"),
        pytest.param([4, 4, 5], 0.0, [4, 4, 5], id="on the roof"),
        pytest.param([2, 2, 5], 0.0, [2, 2, 5], id="on a corner"),
    ],
)
def test_distance_and_nearest_surface(point, distance, nearest):
    obstacles = Obstacles([SQUARE], [HEIGHT_M])
    assert obstacles.signed_distance_m(np.array(point)) == pytest.approx(distance)
    np.testing.assert_allclose(obstacles.nearest_surface(np.array(point)), nearest, atol=1e-12)


@given(st.integers(0, 30), points)
def test_nearest_surface_is_as_far_as_the_distance_says(random_city, seed, point):
    footprints, heights = random_city(seed, count=3)
    obstacles = Obstacles(footprints, heights)
    position = 8.0 * np.array(point) + 10.0
    nearest = obstacles.nearest_surface(position)
    distance = obstacles.signed_distance_m(position)
    assert np.linalg.norm(nearest - position) == pytest.approx(abs(distance), abs=1e-9)
    own = [
        abs(float(Obstacles([f], [h]).signed_distance_m(nearest)))
        for f, h in zip(footprints, heights, strict=True)
    ]
    assert min(own) == pytest.approx(0.0, abs=1e-9)


@given(st.integers(0, 30), points, points)
def test_signed_distance_never_grows_faster_than_one_moves(random_city, seed, first, second):
    """Inside, outside, in overlaps and over roofs: the shield relies on it."""
    obstacles = Obstacles(*random_city(seed, count=3))
    first, second = 8.0 * np.array(first) + 10.0, 8.0 * np.array(second) + 10.0
    here, there = obstacles.signed_distance_m(np.stack((first, second)))
    assert abs(here - there) <= np.linalg.norm(first - second) + 1e-9


@given(st.integers(0, 30), points, points)
def test_a_way_shorter_than_the_clearance_is_free(random_city, seed, start, direction):
    obstacles = Obstacles(*random_city(seed, count=3))
    start, direction = 8.0 * np.array(start) + 10.0, np.array(direction)
    clearance = float(obstacles.signed_distance_m(start))
    assume(clearance > 0.0 and np.linalg.norm(direction) > 1e-3)
    end = start + direction / np.linalg.norm(direction) * clearance * 0.999999
    assert obstacles.crash_depth_m(start, end) == 0.0


QUESTIONS = {
    "crash_depth_m": lambda o, p: o.crash_depth_m(p, p[..., ::-1]),
    "signed_distance_m": lambda o, p: o.signed_distance_m(p),
    "nearest_surface": lambda o, p: o.nearest_surface(p),
    "contains": lambda o, p: o.contains(p),
    "floor_m": lambda o, p: o.floor_m(p),
    "rays": lambda o, p: np.stack(o.horizontal_rays(p, np.linspace(0.0, 6.0, 5), 40.0), axis=-1),
}


@pytest.mark.parametrize("question", QUESTIONS)
@pytest.mark.parametrize("count", [0, 1, 3000])
def test_a_batch_answers_like_its_rows(random_city, question, count):
    """Bit for bit, whatever the chunks."""
    ask = QUESTIONS[question]
    obstacles = Obstacles(*random_city(3))
    position = np.random.default_rng(4).uniform(0.0, 100.0, (count, 3))
    batch = ask(obstacles, position)
    assert len(batch) == count
    for row in range(0, count, 97):
        np.testing.assert_array_equal(ask(obstacles, position[row]), batch[row])
    if count:
        folded = ask(obstacles, position.reshape(-1, count, 3)[:, ::-1])
        np.testing.assert_array_equal(folded[0, ::-1], batch)


@pytest.mark.parametrize("shape", [(3,), (4, 3), (2, 5, 3)])
def test_without_obstacles_everything_is_free(shape):
    nothing = Obstacles([], [])
    position = np.ones(shape)
    assert len(nothing) == 0
    assert np.all(nothing.crash_depth_m(position, position + 1.0) == 0.0)
    assert np.all(nothing.signed_distance_m(position) == np.inf)
    assert np.all(nothing.nearest_surface(position) == np.inf)
    assert not np.any(nothing.contains(position))
    assert np.all(nothing.floor_m(position) == 0.0)
    distance, roof = nothing.horizontal_rays(position, np.zeros(6), 30.0)
    assert distance.shape == roof.shape == (*shape[:-1], 6)
    assert np.all(distance == 30.0)
    assert np.all(roof == 0.0)


def test_one_start_and_many_ends():
    obstacles = Obstacles([SQUARE], [HEIGHT_M])
    ends = np.array([[10.0, 4.0, 1.0], [0.0, 10.0, 1.0]])
    np.testing.assert_allclose(obstacles.crash_depth_m(np.array([0.0, 4.0, 1.0]), ends), [4.0, 0.0])


def test_a_position_that_is_no_number_is_not_free():
    obstacles = Obstacles([SQUARE], [HEIGHT_M])
    nowhere = np.array([np.nan, 4.0, 3.0])
    assert np.isnan(obstacles.signed_distance_m(nowhere))
    assert np.isnan(obstacles.crash_depth_m(nowhere, np.array([9.0, 4.0, 3.0])))


@given(st.integers(0, 2**32 - 1))
def test_many_obstacles_answer_as_each_alone(seed):
    rng = np.random.default_rng(seed)
    footprints, heights = [], []
    for place in rng.uniform(0.0, 300.0, (120, 2)):
        shape = list(SHAPES.values())[rng.integers(len(SHAPES))]
        footprints.append(np.round(place) + shape * float(rng.integers(1, 4)))
        heights.append(float(rng.integers(5, 30)))
    together = Obstacles(footprints, heights)
    points = np.round(rng.uniform(-50.0, 350.0, (60, 3)) * [1.0, 1.0, 0.15])
    points[0, 1] = np.nan
    alone = [
        Obstacles([footprint], [height])
        for footprint, height in zip(footprints, heights, strict=True)
    ]
    distances = np.array([obstacle.signed_distance_m(points) for obstacle in alone])
    np.testing.assert_array_equal(together.signed_distance_m(points), distances.min(axis=0))
    nearest = [
        alone[first].nearest_surface(point)
        for first, point in zip(distances.argmin(axis=0), points, strict=True)
    ]
    np.testing.assert_array_equal(together.nearest_surface(points), nearest)
    one_by_one = [together.signed_distance_m(point) for point in points]
    np.testing.assert_array_equal(together.signed_distance_m(points), one_by_one)
