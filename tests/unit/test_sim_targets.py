import numpy as np
import pytest

from companion.errors import MapError
from companion.world.maps import load_map
from sim.sampling import sample_free
from sim.targets import VERTICES, TargetPaths, random_paths

SQUARE = np.array([[[0.0, 0.0, 5.0], [10.0, 0.0, 5.0], [10.0, 10.0, 5.0], [0.0, 10.0, 5.0]]])


@pytest.mark.parametrize(
    ("time_s", "position", "velocity"),
    [
        pytest.param(0.0, [0.0, 0.0, 5.0], [2.0, 0.0, 0.0], id="start"),
        pytest.param(2.5, [5.0, 0.0, 5.0], [2.0, 0.0, 0.0], id="first edge"),
        pytest.param(7.5, [10.0, 5.0, 5.0], [0.0, 2.0, 0.0], id="second edge"),
        pytest.param(17.5, [0.0, 5.0, 5.0], [0.0, -2.0, 0.0], id="closing edge"),
        pytest.param(42.5, [5.0, 0.0, 5.0], [2.0, 0.0, 0.0], id="two rounds later"),
    ],
)
def test_round_a_square(time_s, position, velocity):
    paths = TargetPaths.through(SQUARE, np.array([2.0]))
    position_enu_m, velocity_enu_mps = paths.at(np.array([time_s]))
    np.testing.assert_allclose(position_enu_m, [position], atol=1e-12)
    np.testing.assert_allclose(velocity_enu_mps, [velocity], atol=1e-12)


def test_resting_targets_rest():
    paths = TargetPaths.resting(np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]))
    position_enu_m, velocity_enu_mps = paths.at(np.array([0.0, 1e4]))
    np.testing.assert_array_equal(position_enu_m, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    assert not velocity_enu_mps.any()


def test_a_path_of_no_length_rests():
    paths = TargetPaths.through(np.full((1, VERTICES, 3), 7.0), np.array([3.0]))
    position_enu_m, velocity_enu_mps = paths.at(np.array([12.3]))
    np.testing.assert_array_equal(position_enu_m, [[7.0, 7.0, 7.0]])
    assert not velocity_enu_mps.any()


def test_random_paths_stay_clear_and_keep_their_speed():
    city = load_map("env1")
    paths = random_paths(city, np.random.default_rng(0), 300, speed_mps=(1.0, 3.0))
    assert ((paths.speed_mps >= 1.0) & (paths.speed_mps <= 3.0)).all()
    for time_s in np.linspace(0.0, 120.0, 240):
        position_enu_m, velocity_enu_mps = paths.at(np.full(300, time_s))
        assert city.is_free(position_enu_m).all()
        np.testing.assert_allclose(
            np.linalg.norm(velocity_enu_mps, axis=1), paths.speed_mps, rtol=1e-9
        )


def test_all_kinds_of_paths_are_drawn():
    paths = random_paths(load_map("free"), np.random.default_rng(1), 600, speed_mps=(1.0, 1.0))
    vertex = paths.vertex_enu_m
    distinct = (np.diff(vertex, axis=1) != 0.0).any(axis=2).sum(axis=1)
    counts = [int((distinct == n).sum()) for n in (2, 5, VERTICES - 1)]
    assert sum(counts) == 600
    assert min(counts) > 100
    circle = vertex[distinct == VERTICES - 1]
    radius_m = np.linalg.norm(circle - circle.mean(axis=1, keepdims=True), axis=2)
    np.testing.assert_allclose(radius_m, radius_m[:, :1].repeat(VERTICES, 1), rtol=1e-9)


def test_free_points_keep_their_margin():
    city = load_map("env1")
    points = sample_free(city, np.random.default_rng(0), 2000, margin_m=3.0)
    assert points.shape == (2000, 3)
    assert (city.obstacles.signed_distance_m(points) > 3.0).all()


def test_a_full_map_is_refused(tmp_path):
    path = tmp_path / "full.yaml"
    path.write_text(
        "name: full\nsize_m: [10, 10, 10]\norigin: {latitude_deg: 47, longitude_deg: 8, "
        "altitude_m: 400}\nobstacles: [{name: block, "
        "footprint_m: [[0, 0], [10, 0], [10, 10], [0, 10]], height_m: 10}]\n"
    )
    with pytest.raises(MapError, match="no free space"):
        sample_free(load_map(path), np.random.default_rng(0), 1, margin_m=0.1)
