"""The bundled maps: what the paper says of them, and their pictures."""

import sys
from pathlib import Path

import numpy as np
import pytest

from companion.errors import UsageError
from companion.world.draw import draw_map
from companion.world.frames import GeoPoint, LocalTie
from companion.world.maps import bundled_maps, describe_map, load_map


def test_bundled_maps_are_named_like_their_files():
    assert bundled_maps() == ["env1", "env2", "free", "zurich"]
    for name in bundled_maps():
        assert load_map(name).name == name


@pytest.mark.parametrize("name", ["free", "env1", "env2"])
def test_the_papers_maps_are_cubes_of_100_m_with_room_to_launch(name):
    city = load_map(name)
    np.testing.assert_array_equal(city.size_m, [100.0, 100.0, 100.0])
    assert city.launch_enu_m is not None
    assert city.is_free(city.launch_enu_m, 8.0)


def test_env1_keeps_the_papers_word():
    city = load_map("env1")
    heights = dict(zip(city.obstacle_names, city.heights_m, strict=True))
    assert heights["obs2"] == max(heights.values()) == 100.0
    assert len(set(heights.values())) > 3


def test_env2_keeps_the_papers_word():
    city = load_map("env2")
    heights = dict(zip(city.obstacle_names, city.heights_m, strict=True))
    assert heights["obs2"] == 50.0
    assert len(city.obstacles) >= 6
    for name in ("obs2", "obs6"):
        footprint = city.footprints_m[city.obstacle_names.index(name)]
        over = np.append(footprint.mean(axis=0), 63.0)
        assert city.is_free(over, 8.0)


@pytest.mark.parametrize(("name", "percent"), [("env1", 48.8), ("env2", 51.5), ("zurich", 83.2)])
def test_maps_are_as_hard_as_they_say(name, percent):
    city = load_map(name)
    assert f"free for {percent} % of start and target pairs" in city.description
    candidates = np.random.default_rng(0).uniform(0.0, city.size_m, (40_000, 3))
    free = candidates[city.is_free(candidates)]
    start, end = free[: len(free) // 2], free[len(free) // 2 :][: len(free) // 2]
    share = 100.0 * np.mean(city.obstacles.crash_depth_m(start, end) == 0.0)
    assert share == pytest.approx(percent, abs=1.5)  # four standard errors


def test_px4_sitl_starts_on_a_free_spot_in_zurich():
    city = load_map("zurich")
    home = GeoPoint(47.397742, 8.545594, 488.0)
    tie = LocalTie.from_origins(city.origin, home)
    home_enu_m = tie.position_to_map(np.zeros(3))
    np.testing.assert_allclose(home_enu_m, [94.0, 96.0, 0.0], atol=0.01)
    assert city.is_free(home_enu_m + np.array([0.0, 0.0, 2.0]), 8.0)
    assert 10 <= len(city.obstacles) <= 25


@pytest.mark.parametrize("name", ["free", "env1", "env2", "zurich"])
def test_descriptions_fit_a_terminal(name):
    city = load_map(name)
    text = describe_map(city)
    assert max(len(line) for line in text.splitlines()) <= 80
    assert city.content_hash in text
    for obstacle in city.obstacle_names:
        assert obstacle in text


@pytest.mark.parametrize("name", ["free", "env2", "zurich"])
def test_drawings_are_png(tmp_path, name):
    png = tmp_path / "map.png"
    path = np.array([[10.0, 10.0, 5.0], [40.0, 50.0, 60.0], [90.0, 90.0, 20.0]])
    draw_map(load_map(name), png, [path, path[:2]], target=path[-1])
    data = png.read_bytes()
    assert data.startswith(b"\x89PNG")
    assert int.from_bytes(data[16:20], "big") == 880


def test_a_drawing_that_cannot_be_written(tmp_path):
    with pytest.raises(UsageError, match=r"cannot write .*no.such.folder"):
        draw_map(load_map("free"), tmp_path / "no such folder" / "map.png")


def test_without_matplotlib_the_message_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(UsageError, match=r'pip install "mavlink-companion\[training\]"'):
        draw_map(load_map("free"), tmp_path / "map.png")


def test_a_checkout_finds_its_maps_at_the_root():
    root = Path(__file__).parents[2]
    assert sorted(path.stem for path in (root / "maps").glob("*.yaml")) == bundled_maps()
