"""Map files: the bundled ones, and what a stranger reads when theirs is wrong."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.errors import MapError
from companion.world.frames import GeoPoint
from companion.world.map_file import MAX_FILE_BYTES
from companion.world.maps import build_map, describe_map, load_map

YARD = """\
name: yard  # a comment
description: Two sheds.
size_m: [100, 80, 60.5]
obstacles:
  - name: shed
    footprint_m: [[10, 10], [20, 10], [20, 30], [10, 30]]
    height_m: 12
  - name: barn
    footprint_m: [[50, 10], [70, 10], [60, 30]]
    height_m: 8.5
launch_m: [5, 5, 0]
"""
SQUARE = [[10.0, 10.0], [20.0, 10.0], [20.0, 20.0], [10.0, 20.0]]
ORIGIN = "origin: {latitude_deg: 47.0, longitude_deg: 8.0, altitude_m: 400}"


@pytest.fixture
def load(tmp_path):
    """Write a map file and load it."""

    def write_and_load(text):
        path = tmp_path / "yard.yaml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return load_map(path)

    return write_and_load


def test_a_map_from_a_file(load):
    yard = load(YARD)
    assert yard.name == "yard"
    assert yard.description == "Two sheds."
    np.testing.assert_array_equal(yard.size_m, [100.0, 80.0, 60.5])
    assert yard.edge_m == 100.0
    assert yard.obstacle_names == ("shed", "barn")
    assert len(yard.obstacles) == 2
    np.testing.assert_array_equal(yard.heights_m, [12.0, 8.5])
    np.testing.assert_array_equal(yard.footprints_m[1], [[50, 10], [70, 10], [60, 30]])
    np.testing.assert_array_equal(yard.launch_enu_m, [5.0, 5.0, 0.0])
    assert yard.origin is None


def test_a_map_with_a_place_on_earth(load):
    yard = load(YARD.replace("launch_m: [5, 5, 0]", ORIGIN))
    assert yard.origin == GeoPoint(47.0, 8.0, 400.0)
    assert yard.launch_enu_m is None


@pytest.mark.parametrize(
    ("position", "inside", "free"),
    [
        pytest.param([5, 5, 5], True, True, id="free"),
        pytest.param([15, 20, 5], True, False, id="in the shed"),
        pytest.param([10, 20, 5], True, False, id="touching the shed"),
        pytest.param([10 - 1e-9, 20, 5], True, True, id="just not touching"),
        pytest.param([15, 20, 12], True, False, id="on its roof"),
        pytest.param([0, 0, 0], True, True, id="corner of the map"),
        pytest.param([100, 80, 60.5], True, True, id="opposite corner"),
        pytest.param([100.001, 80, 60], False, False, id="east of it"),
        pytest.param([5, 5, -0.001], False, False, id="below ground"),
        pytest.param([5, 5, 60.6], False, False, id="too high"),
        pytest.param([np.nan, 5, 5], False, False, id="nowhere"),
    ],
)
def test_inside_and_free(load, position, inside, free):
    yard = load(YARD)
    assert yard.contains(np.array(position)) == inside
    assert yard.is_free(np.array(position)) == free
    batch = np.tile(position, (2, 3, 1))
    assert np.all(yard.contains(batch) == inside)
    assert np.all(yard.is_free(batch) == free)


def test_free_with_a_margin(load):
    yard = load(YARD)
    west_of_the_shed = np.array([[7.9, 20.0, 5.0], [8.0, 20.0, 5.0], [8.1, 20.0, 5.0]])
    np.testing.assert_array_equal(yard.is_free(west_of_the_shed, 2.0), [True, False, False])


WRONG = {
    "not a mapping": ("[1, 2]", "expected `object`, got `array`"),
    "empty": ("", "expected `object`, got `null`"),
    "no YAML": ("name: [", "not valid YAML: .*line 2, column 1"),
    "tag": ("name: !!python/object:os.system {}", "aliases and tags are not allowed"),
    "not text": (b"\xff\xfe\x00", "not UTF-8 text"),
    "control character": ("name: \x07", "not valid YAML"),
    "too deep": ("[" * 20_000, "not valid YAML: .*nest"),
    "too large": ("#" * (MAX_FILE_BYTES + 1), "larger than 8192 KiB"),
    "date": (YARD.replace("name: yard", "name: 2024-13-45"), "not valid YAML: month must be"),
    "unknown key": (YARD + "wind: 3\n", "unknown field `wind`"),
    "misspelt key": (
        YARD.replace("height_m: 12", "hight_m: 12"),
        r"obstacles\[0\]: .*unknown field `hight_m`",
    ),
    "key twice": (YARD + "name: other\n", "key name appears twice"),
    "key twice, deeper": (
        YARD.replace("height_m: 12", "height_m: 12\n    height_m: 2"),
        "key height_m appears twice",
    ),
    "number in disguise": (YARD.replace("12", "!!int ''"), "aliases and tags are not allowed"),
    "number without digits": (YARD.replace("12", "0x_"), "not valid YAML: invalid literal"),
    "alias": (
        YARD.replace("name: barn", "name: &a barn\n    x: *a"),
        "aliases and tags are not allowed",
    ),
    "missing": (YARD.replace("size_m: [100, 80, 60.5]\n", ""), "required field `size_m`"),
    "word for number": (
        YARD.replace("height_m: 12", "height_m: high"),
        r"obstacles\[0\].height_m: expected `float`, got `str`",
    ),
    "truth for number": (
        YARD.replace("height_m: 12", "height_m: yes"),
        r"obstacles\[0\].height_m: expected `float`, got `bool`",
    ),
    "corner in 3-D": (
        YARD.replace("[60, 30]", "[60, 30, 4]"),
        r"obstacles\[1\].footprint_m\[2\]: expected `array` of length 2, got 3",
    ),
    "two sides": (YARD.replace("60.5]", "]").replace("80, ]", "80]"), "size_m: .*length 3, got 2"),
    "no name": (YARD.replace("name: yard", "name: ''"), "name must be printable and not empty"),
    "name with a newline": (YARD.replace("name: yard", 'name: "a\\nb"'), "name must be printable"),
    "unprintable description": (YARD.replace("Two", "\u202e"), "description must be printable"),
    "unprintable key": (YARD.replace("size_m", "size_\u202em"), r"unknown field `size_\\u202em`"),
    "flat": (YARD.replace("60.5", "0"), "size_m must be three lengths between 0 and 10000 m"),
    "endless": (YARD.replace("60.5", ".inf"), "size_m must be three lengths"),
    "no size": (YARD.replace("60.5", ".nan"), "size_m must be three lengths"),
    "two corners": (
        YARD.replace("[[50, 10], [70, 10], [60, 30]]", "[[50, 10], [70, 10], [50, 10]]"),
        r"obstacles\[1\].footprint_m needs at least 3 corners, got 2",
    ),
    "corner twice": (
        YARD.replace("[70, 10], [60", "[70, 10], [70, 10], [60"),
        r"obstacles\[1\].footprint_m\[2\] repeats the corner before it",
    ),
    "on a line": (
        YARD.replace("[60, 30]", "[60, 10]"),
        r"obstacles\[1\].footprint_m has no area",
    ),
    "crossing": (
        YARD.replace("[20, 30], [10, 30]", "[10, 30], [20, 30]"),
        r"obstacles\[0\].footprint_m crosses itself near \(15.0, 20.0\)",
    ),
    "touching": (
        YARD.replace("[20, 30], [10, 30]", "[20, 30], [15, 10], [10, 30]"),
        r"obstacles\[0\].footprint_m touches itself near \(15.0, 10.0\)",
    ),
    "outside": (
        YARD.replace("[60, 30]", "[60, 80.5]"),
        r"obstacles\[1\].footprint_m\[2\] \(60.0, 80.5\) is outside the map \(100 x 80 m\)",
    ),
    "corner nowhere": (
        YARD.replace("[60, 30]", "[60, .nan]"),
        r"obstacles\[1\].footprint_m\[2\] .* is outside the map",
    ),
    "no height": (
        YARD.replace("height_m: 12", "height_m: 0"),
        r"obstacles\[0\].height_m must be above 0 and at most the map's 60.5 m, got 0.0",
    ),
    "too high": (YARD.replace("height_m: 12", "height_m: 60.6"), r"obstacles\[0\].height_m must"),
    "height nowhere": (
        YARD.replace("height_m: 12", "height_m: .nan"),
        r"\.height_m must .*got nan",
    ),
    "name taken": (YARD.replace("name: barn", "name: shed"), r"obstacles\[1\].name shed is taken"),
    "unnamed": (YARD.replace("name: barn", "name: ' '"), r"obstacles\[1\].name must be printable"),
    "no place": (
        YARD.replace("launch_m: [5, 5, 0]", ""),
        "exactly one of origin and launch_m .*nei",
    ),
    "two places": (YARD + ORIGIN, "exactly one of origin and launch_m must be given, found both"),
    "launch in a shed": (YARD.replace("[5, 5, 0]", "[15, 20, 0]"), "launch_m .*inside an obstacle"),
    "launch outside": (YARD.replace("[5, 5, 0]", "[5, 5, -1]"), "launch_m .*is outside the map"),
    "launch far away": (YARD.replace("[5, 5, 0]", "[.inf, 5, 0]"), "launch_m .* outside the map"),
    "latitude": (
        YARD.replace("launch_m: [5, 5, 0]", ORIGIN.replace("47.0", "90.5")),
        "origin.latitude_deg must be within -90 and 90, got 90.5",
    ),
    "longitude": (
        YARD.replace("launch_m: [5, 5, 0]", ORIGIN.replace("8.0", ".nan")),
        "origin.longitude_deg must be within",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_an_error_names_file_and_field_in_one_line(load, case):
    text, problem = WRONG[case]
    with pytest.raises(MapError, match=problem) as caught:
        load(text)
    message = str(caught.value)
    assert message.startswith("cannot load map ")
    assert "yard.yaml: " in message
    assert "\n" not in message


@pytest.mark.parametrize(
    "spelling",
    [
        "[\n      [50, 10], [70.0, 1e1],\n      [60, 30]]",
        "[[50., 10], [70, +10], [60, 30]]",
        "[[50, 10], [70, 10], # the barn's gable\n      [60, 30]]",
        "[[50, 10], [70, 10], [60, 30],]",
        "\n      - [50, 10]\n      - [70, 10]\n      - [60, 30]",
        "[[50, 10], [70, 10], [60, 30]]   ",
    ],
)
def test_corners_may_be_written_as_yaml_allows(load, spelling):
    # "1e1" is text to YAML 1.1 but a number to everybody else.
    yard = load(YARD.replace("[[50, 10], [70, 10], [60, 30]]", spelling))
    np.testing.assert_array_equal(yard.footprints_m[1], [[50, 10], [70, 10], [60, 30]])


def test_an_error_below_an_outline_of_many_lines_names_its_line(load):
    text = YARD.replace("[[50, 10], ", "[[50,\n 10],\n\n      ") + "oops: [\n"
    with pytest.raises(MapError, match=rf"line {text.count(chr(10)) + 1}, column 1"):
        load(text)


@pytest.mark.parametrize("slip", ["crosses itself", "outside", "height", "repeats", "at least 3"])
def test_one_slip_among_many_obstacles_is_found(slip):
    outlines = [np.add(SQUARE, (0.0, 15.0 * index)) for index in range(50)]
    heights = [10.0] * 50
    if slip == "crosses itself":
        outlines[31] = outlines[31][[0, 2, 1, 3]]
    elif slip == "outside":
        outlines[31] = outlines[31] - (10.5, 0.0)
    elif slip == "height":
        heights[31] = 99.0
    elif slip == "repeats":
        outlines[31] = outlines[31][[0, 1, 1, 2, 3]]
    else:
        outlines[31] = outlines[31][:2]
    with pytest.raises(MapError, match=rf"obstacles\[31\].*{slip}"):
        build_map("row", (100, 1000, 50), outlines, heights)


@given(st.binary(max_size=300))
def test_no_bytes_end_in_anything_but_a_map_error(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("bytes") / "yard.yaml"
    path.write_bytes(data)
    with pytest.raises(MapError):
        load_map(path)


@given(st.integers(0, len(YARD) - 1), st.text(max_size=4))
def test_no_slip_of_the_pen_ends_in_anything_but_a_map_error(tmp_path_factory, position, slip):
    path = tmp_path_factory.mktemp("slips") / "yard.yaml"
    path.write_bytes((YARD[:position] + slip + YARD[position + 1 :]).encode(errors="replace"))
    try:
        said = describe_map(load_map(path)).partition("\n")[0]
    except MapError as error:
        said = str(error)
    assert said.isprintable()


@pytest.mark.parametrize("missing", ["nowhere.yaml", "maps/nowhere.yaml", "./nowhere", "nowhere"])
def test_a_missing_map_lists_the_bundled_ones(missing):
    with pytest.raises(MapError, match=r"nowhere.*bundled.*env1, env2, free, zurich"):
        load_map(missing)


def test_a_folder_is_no_map(tmp_path):
    with pytest.raises(MapError, match=r"cannot load map .*: is a directory"):
        load_map(tmp_path)


def test_the_hash_is_of_the_content(load):
    yard = load(YARD)
    assert len(yard.content_hash) == 64
    shed_first, barn = YARD.split("  - name: barn")
    head, shed = shed_first.split("  - name: shed")
    barn, launch = barn.split("launch_m")
    for same in (
        YARD.replace("  # a comment", "").replace("12", "12.0"),
        YARD.replace("name: yard", "name: other").replace("Two", "2").replace("barn", "hut"),
        YARD.replace("[[50, 10], [70, 10], [60, 30]]", "[[60, 30], [50, 10], [70, 10]]"),
        YARD.replace("[[50, 10], [70, 10], [60, 30]]", "[[60, 30], [70, 10], [50, 10]]"),
        YARD.replace("[60, 30]]", "[60, 30], [50, 10]]"),
        YARD.replace("launch_m: [5, 5, 0]", ORIGIN),
        f"{head}  - name: barn{barn}  - name: shed{shed}launch_m{launch}",
    ):
        assert load(same).content_hash == yard.content_hash
    for other in (
        YARD.replace("height_m: 12", "height_m: 12.000001"),
        YARD.replace("[60, 30]", "[60, 31]"),
        YARD.replace("60.5", "61"),
    ):
        assert load(other).content_hash != yard.content_hash


def test_a_map_from_footprints():
    city = build_map("city", [100, 50, 40], [SQUARE, np.array(SQUARE) + 15.0], [10.0, 20])
    assert city.obstacle_names == ("obs1", "obs2")
    assert city.edge_m == 100.0
    assert (city.origin, city.launch_enu_m) == (None, None)
    with pytest.raises(MapError, match=r"obstacles\[1\].height_m"):
        build_map("city", [100, 50, 40], [SQUARE, SQUARE], [10.0, 50.0])


def test_how_far_outside_the_box():
    city = load_map("free")  # a cube of 100 m
    for place, outside_m in [
        ((50.0, 50.0, 50.0), 0.0),
        ((0.0, 100.0, -3.0), 0.0),
        ((-3.0, 104.0, 50.0), 5.0),
        ((50.0, 50.0, 112.0), 12.0),
    ]:
        assert city.outside_m(np.array(place)) == outside_m
