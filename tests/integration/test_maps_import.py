"""``companion maps import`` from the command line to a map that flies."""

import json

import numpy as np
import pytest

from companion import cli
from companion.world.frames import GeoPoint, enu_to_geodetic
from companion.world.maps import describe_map, load_map

SYDNEY = GeoPoint(-33.8700, 151.2000, 0.0)


def footprint(east_m, north_m, side_m):
    corners = ((0, 0), (side_m, 0), (side_m, side_m), (0, side_m), (0, 0))
    places = [enu_to_geodetic(SYDNEY, np.array([east_m + x, north_m + y, 0.0])) for x, y in corners]
    return [[place.longitude_deg, place.latitude_deg] for place in places]


def building(number, *rings, **tags):
    return {
        "type": "Feature",
        "id": f"way/{number}",
        "properties": {"building": "yes"} | tags,
        "geometry": {"type": "Polygon", "coordinates": list(rings)},
    }


@pytest.fixture(scope="module")
def town_text():
    """A block of 15 x 20 buildings, every tenth round a courtyard."""
    features = [
        building(
            20 * row + column,
            footprint(25.0 * column, 25.0 * row, 16.0),
            *[footprint(25.0 * column + 4.0, 25.0 * row + 4.0, 8.0)] * (column % 10 == 0),
            **({"height": f"{8 + row} m"} if column % 2 else {"building:levels": "4"}),
        )
        for row in range(15)
        for column in range(20)
    ]
    return json.dumps({"type": "FeatureCollection", "features": features})


@pytest.fixture
def town(town_text, tmp_path):
    path = tmp_path / "town.geojson"
    path.write_text(town_text)
    return path


def run(capfd, *words):
    with pytest.raises(SystemExit) as end:
        cli.main(["maps", *map(str, words)])
    out, err = capfd.readouterr()
    return end.value.code or 0, out, err


def test_a_town_becomes_a_map(town, tmp_path, capfd):
    path = tmp_path / "town.yaml"
    code, out, err = run(capfd, "import", town, "--out", path, "--altitude", "40")
    assert (code, err) == (0, "")
    assert "300 as 330 obstacles, of 300 features" in out
    assert "150 given, 150 from storeys of 3 m, 0 assumed 15 m" in out
    assert "30 open" in out
    assert f"wrote {path}" in out.replace("\n", "")
    assert all(len(line) <= 80 for line in out.splitlines() if not line.startswith("wrote"))

    city = load_map(path)
    assert len(city.obstacles) == 330
    assert city.origin is not None
    assert city.origin.altitude_m == 40.0
    assert "300 buildings from town.geojson" in describe_map(city)
    # The first building's courtyard, 10 m of open ground around all of them.
    assert city.is_free(np.array([18.0, 18.0, 5.0]), 3.9)
    assert not city.is_free(np.array([12.0, 12.0, 5.0]))
    assert city.size_m[:2] == pytest.approx([511.0, 386.0], abs=1.1)

    code, out, _ = run(capfd, "check", path)
    assert code == 0
    assert city.content_hash in out
    assert "and 280 more, none of them higher" in out


def test_a_box_south_of_the_equator(town, tmp_path, capfd):
    path = tmp_path / "part.yaml"
    code, out, err = run(
        capfd, "import", town, "--out", path, "--box", "-33.870,151.200,-33.869,151.201"
    )
    assert code == 0
    assert "outside the box" in out
    assert "warning: the ground is taken to be at 0 m AMSL" in err
    city = load_map(path)
    assert city.name == "town"
    assert city.size_m[:2] == pytest.approx([92.5, 111.0], abs=0.3)
    code, _, _ = run(
        capfd, "import", town, "--out", path, "--force", "--center", "-33.869,151.201", "--size",
        "100", "--name", "square", "--ceiling", "60",
    )  # fmt: skip
    assert code == 0
    assert load_map(path).size_m.tolist() == [100.0, 100.0, 60.0]
    assert load_map(path).name == "square"


def test_nothing_is_overwritten_unasked(town, tmp_path, capfd):
    path = tmp_path / "town.yaml"
    path.write_text("precious")
    code, out, err = run(capfd, "import", town, "--out", path)
    assert (code, out) == (2, "")
    assert err == f"companion: {path} exists: --force overwrites it, --out names another\n"
    assert path.read_text() == "precious"
    assert run(capfd, "import", town, "--out", path, "--force")[0] == 0
    assert load_map(path).name == "town"
    assert sorted(found.name for found in tmp_path.iterdir()) == ["town.geojson", "town.yaml"]


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["--out", "town.txt"], 2, "--out town.txt: the name of a map file ends with .yaml"),
        (["--box", "1,2,3"], 2, "--box 1,2,3: expected LAT,LON,LAT,LON in degrees"),
        (["--box", "a,b,c,d"], 2, "expected LAT,LON,LAT,LON"),
        (["--box", "91,0,92,0"], 2, "no such latitude or longitude"),
        (["--center", "1,2"], 2, "--center and --size, not both"),
        (["--size", "100"], 2, "--center and --size, not both"),
        (["--center", "1,2", "--size", "-5"], 2, "--size -5: a length above 0 m"),
        (["--center", "1,2", "--size", "nan"], 2, "--size nan: a length above 0 m"),
        (["--default-height", "0"], 2, "--default-height 0: a length above 0 m"),
        (["--default-height", "150"], 2, "--default-height 150 is above --ceiling 100"),
        (["--tolerance", "9"], 2, "--tolerance 9: 0 to 5 m"),
        (["--altitude", "nan"], 2, "--altitude nan: metres above mean sea level"),
        (["--center", "1,2", "--size", "20000"], 5, "the box is 20000 x 20000 m"),
        (["--center", "1,2", "--size", "200"], 5, "no buildings in the box: the file's lie"),
        (["--box", "-33.87,151.2,-33.86,-151.3"], 5, "antimeridian"),
        (["--out", "nowhere/town.yaml"], 2, "cannot write nowhere/town.yaml: No such file"),
    ],
)
def test_what_makes_no_sense_is_refused_in_one_line(
    town, tmp_path, monkeypatch, capfd, words, code, message
):
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.iterdir())
    found, out, err = run(capfd, "import", town, *words)
    assert (found, out) == (code, "")
    assert err.startswith("companion: ")
    assert err.count("\n") == 1
    assert message in err
    if code == 5:
        assert str(town) in err
    assert sorted(tmp_path.iterdir()) == before


def test_files_that_are_no_footprints_are_named(tmp_path, capfd):
    for name, content in (("a.geojson", b"\x00"), ("b.json", b'{"type": "Topology\\u202e"}')):
        path = tmp_path / name
        path.write_bytes(content)
        code, out, err = run(capfd, "import", path)
        assert (code, out, err.count("\n")) == (5, "", 1)
        assert err.startswith(f"companion: cannot import {path}: not ")
        assert err.rstrip("\n").isprintable()
    code, _, err = run(capfd, "import", tmp_path / "c.json")
    assert code == 5
    assert "no such file or directory" in err


def test_a_map_that_would_be_too_large_is_refused(town, tmp_path, monkeypatch, capfd):
    monkeypatch.setattr("companion.world.map_writer.MAX_FILE_BYTES", 20 * 1024)
    code, _, err = run(capfd, "import", town, "--out", tmp_path / "town.yaml")
    assert code == 5
    assert "(330 obstacles) and a map file has at most 20: choose a smaller --box" in err
    assert not (tmp_path / "town.yaml").exists()
