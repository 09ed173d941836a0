"""Planes of survey files, against published points and against the arc of a meridian."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.errors import MapError
from companion.world.projections import to_degrees

EARTH_M, FLATTENING = 6_378_137.0, 1.0 / 298.257223563
SQUARE_ECCENTRICITY = FLATTENING * (2.0 - FLATTENING)


def meridian_arc_m(latitude_rad):
    """Integrate the radius of curvature from the equator, by Gauss's rule."""
    node, weight = np.polynomial.legendre.leggauss(40)
    latitude = 0.5 * latitude_rad * (node + 1.0)
    radius_m = EARTH_M * (1.0 - SQUARE_ECCENTRICITY)
    radius_m /= (1.0 - SQUARE_ECCENTRICITY * np.sin(latitude) ** 2) ** 1.5
    return 0.5 * latitude_rad * (weight * radius_m).sum()


@given(st.floats(-84.0, 84.0), st.integers(1, 60))
def test_on_the_middle_of_a_zone_utm_is_the_arc_of_the_meridian(latitude_deg, zone):
    south = latitude_deg < 0.0
    north_m = 0.9996 * meridian_arc_m(np.deg2rad(latitude_deg)) + 1e7 * south
    crs = f"EPSG:{327 if south else 326}{zone:02d}"
    found_deg = to_degrees(crs)(np.array([[500_000.0, north_m]]))[0]
    assert found_deg[0] == pytest.approx(6.0 * zone - 183.0, abs=1e-9)
    assert found_deg[1] == pytest.approx(latitude_deg, abs=2e-8)  # 2 mm


@pytest.mark.parametrize(
    ("crs", "place_m", "latitude_deg", "longitude_deg"),
    [
        # The CN Tower, as its article in the encyclopaedia has it, to the metre.
        ("EPSG:32617", (630_084.0, 4_833_438.0), 43.642567, -79.387139),
        # Corners of EPSG:3857's own area of use, and a point of EPSG's guidance note 7-2.
        ("EPSG:3857", (20_037_508.34, 20_048_966.10), 85.06, 180.0),
        ("EPSG:3857", (-11_169_055.58, 2_800_000.0), 24.381786944, -100.333333333),
    ],
)
def test_published_points(crs, place_m, latitude_deg, longitude_deg):
    found_deg = to_degrees(crs)(np.array([place_m]))[0]
    assert found_deg[0] == pytest.approx(longitude_deg, abs=1e-5)
    assert found_deg[1] == pytest.approx(latitude_deg, abs=1e-5)


@given(st.floats(166_000.0, 834_000.0), st.floats(1_000.0, 9_300_000.0))
def test_lengths_are_those_on_the_ellipsoid(east_m, north_m):
    """A metre on the plane, times the zone's scale there, is a metre on the ellipsoid."""
    around_m = np.array([(east_m, north_m), (east_m + 1.0, north_m), (east_m, north_m + 1.0)])
    longitude, latitude = np.deg2rad(to_degrees("EPSG:32633")(around_m)).T
    bend = 1.0 - SQUARE_ECCENTRICITY * np.sin(latitude[0]) ** 2
    across_m = EARTH_M / np.sqrt(bend) * np.cos(latitude[0])
    along_m = EARTH_M * (1.0 - SQUARE_ECCENTRICITY) / bend**1.5
    ways_m = np.hypot(across_m * np.diff(longitude), along_m * np.diff(latitude))
    first_m = ways_m[0]
    second_m = np.hypot(
        across_m * (longitude[2] - longitude[0]), along_m * (latitude[2] - latitude[0])
    )
    # Snyder's series for the scale, to the second order.
    radius_m = np.sqrt(along_m * EARTH_M / np.sqrt(bend))
    scale = 0.9996 * (1.0 + ((east_m - 5e5) / (0.9996 * radius_m)) ** 2 / 2.0)
    assert first_m * scale == pytest.approx(1.0, abs=1e-5)
    assert second_m * scale == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize(
    "crs",
    [
        "EPSG:32632",
        "urn:ogc:def:crs:EPSG::25832",
        "urn:ogc:def:crs:EPSG:6.9:32632",
        "http://www.opengis.net/def/crs/EPSG/0/25832",
        " epsg:32632 ",
    ],
)
def test_spellings_of_a_zone(crs):
    found_deg = to_degrees(crs)(np.array([[500_000.0, 5_300_000.0]]))[0]
    assert found_deg == pytest.approx([9.0, 47.8534], abs=1e-3)


@pytest.mark.parametrize("crs", ["EPSG:2056", "EPSG:32661", "EPSG:3035", "local", "", "EPSG:326"])
def test_other_planes_are_refused_with_what_to_do(crs):
    with pytest.raises(MapError, match="ogr2ogr -t_srs EPSG:4326"):
        to_degrees(crs)


def test_what_is_no_place_on_a_plane_does_not_overflow():
    wild_m = np.array([[1e308, -1e308], [np.nan, 0.0], [0.0, 2e7]])
    for crs in ("EPSG:3857", "EPSG:32601"):
        assert to_degrees(crs)(wild_m).shape == (3, 2)
