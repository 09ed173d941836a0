"""Frames against pymap3d, on both hemispheres and near the pole."""

import numpy as np
import pymap3d
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from companion.errors import MapError
from companion.world.frames import (
    GeoPoint,
    LocalTie,
    enu_to_geodetic,
    enu_to_ned,
    geodetic_to_enu,
    ned_to_enu,
)

PLACES = {
    "Zurich": GeoPoint(47.397742, 8.545594, 488.0),
    "Canberra": GeoPoint(-35.363262, 149.165237, 584.0),
    "equator, date line": GeoPoint(0.0, 179.9999, 0.0),
    "Ushuaia": GeoPoint(-54.8, -68.3, 12.0),
    "near the pole": GeoPoint(89.99, 30.0, 3.0),
}
places = pytest.mark.parametrize("place", PLACES.values(), ids=PLACES)
metres = st.floats(-2000.0, 2000.0)
vectors = arrays(np.float64, (3,), elements=metres)


@pytest.mark.parametrize(
    ("enu", "ned"),
    [
        pytest.param([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], id="east"),
        pytest.param([0.0, 1.0, 0.0], [1.0, 0.0, 0.0], id="north"),
        pytest.param([0.0, 0.0, 1.0], [0.0, 0.0, -1.0], id="up is negative down"),
    ],
)
def test_axes(enu, ned):
    np.testing.assert_array_equal(enu_to_ned(np.array(enu)), ned)
    np.testing.assert_array_equal(ned_to_enu(np.array(ned)), enu)


@pytest.mark.parametrize("shape", [(3,), (4, 3), (2, 5, 3), (0, 3)])
def test_any_leading_shape_and_no_alias(shape):
    vector = np.arange(np.prod(shape), dtype=np.float64).reshape(shape)
    before = vector.copy()
    turned = enu_to_ned(vector)
    turned += 1.0
    assert turned.shape == shape
    np.testing.assert_array_equal(vector, before)
    np.testing.assert_array_equal(ned_to_enu(enu_to_ned(vector)), vector)


@places
@given(vectors)
def test_geodetic_round_trip(place, position_enu_m):
    again = geodetic_to_enu(place, enu_to_geodetic(place, position_enu_m))
    np.testing.assert_allclose(again, position_enu_m, atol=1e-6)


@places
def test_geodetic_agrees_with_pymap3d(place):
    point = enu_to_geodetic(place, np.array([120.0, -80.0, 35.0]))
    expected = pymap3d.enu2geodetic(
        120.0, -80.0, 35.0, place.latitude_deg, place.longitude_deg, place.altitude_m
    )
    assert (point.latitude_deg, point.longitude_deg, point.altitude_m) == pytest.approx(expected)


def test_north_is_north_on_both_hemispheres():
    for place in (PLACES["Zurich"], PLACES["Canberra"]):
        north = enu_to_geodetic(place, np.array([0.0, 100.0, 0.0]))
        assert north.latitude_deg > place.latitude_deg
        east = enu_to_geodetic(place, np.array([100.0, 0.0, 0.0]))
        assert east.longitude_deg > place.longitude_deg


@places
@given(vectors, vectors)
def test_tie_takes_the_way_over_the_earth(place, offset_enu_m, position_ned_m):
    """Local NED to the map is local NED to WGS84 to the map, within a millimetre over 2 km."""
    local_origin = enu_to_geodetic(place, offset_enu_m)
    tie = LocalTie.from_origins(place, local_origin)
    point = GeoPoint(
        *pymap3d.ned2geodetic(
            *position_ned_m,
            local_origin.latitude_deg,
            local_origin.longitude_deg,
            local_origin.altitude_m,
        )
    )
    expected = geodetic_to_enu(place, point)
    np.testing.assert_allclose(tie.position_to_map(position_ned_m), expected, atol=1e-6)
    np.testing.assert_allclose(tie.geodetic_to_map(point), expected, atol=1e-6)


@places
@given(vectors, vectors)
def test_tie_round_trips(place, offset_enu_m, position_enu_m):
    for tie in (
        LocalTie.from_origins(place, enu_to_geodetic(place, offset_enu_m)),
        LocalTie.from_launch(offset_enu_m, place),
    ):
        local = tie.position_to_local(position_enu_m)
        np.testing.assert_allclose(tie.position_to_map(local), position_enu_m, atol=1e-6)
        there = tie.map_to_geodetic(position_enu_m)
        np.testing.assert_allclose(tie.geodetic_to_map(there), position_enu_m, atol=1e-6)
        velocity = tie.velocity_to_map(tie.velocity_to_local(position_enu_m))
        np.testing.assert_allclose(velocity, position_enu_m, atol=1e-9)


@places
@given(vectors)
def test_tie_turns_and_never_stretches(place, offset_enu_m):
    tie = LocalTie.from_origins(place, enu_to_geodetic(place, offset_enu_m))
    np.testing.assert_allclose(tie.local_to_map @ tie.local_to_map.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(tie.local_to_map) == pytest.approx(1.0)


def test_near_the_pole_north_turns_with_the_meridian():
    """1 km from the pole, a kilometre east is an eighth of a turn around it and more."""
    pole = PLACES["near the pole"]
    tie = LocalTie.from_origins(pole, enu_to_geodetic(pole, np.array([1117.0, 0.0, 0.0])))
    north = tie.velocity_to_map(np.array([1.0, 0.0, 0.0]))
    assert np.degrees(np.arctan2(-north[0], north[1])) == pytest.approx(45.0, abs=0.1)


def test_the_same_origin_ties_axis_to_axis():
    place = PLACES["Zurich"]
    tie = LocalTie.from_origins(place, place)
    np.testing.assert_allclose(
        tie.position_to_map(np.array([1.0, 2.0, -3.0])), [2.0, 1.0, 3.0], atol=1e-9
    )


def test_altitudes_are_differences():
    place = PLACES["Zurich"]
    higher = GeoPoint(place.latitude_deg, place.longitude_deg, place.altitude_m + 25.0)
    tie = LocalTie.from_origins(place, higher)
    np.testing.assert_allclose(tie.local_origin_enu_m, [0.0, 0.0, 25.0], atol=1e-9)


def test_launch_tie_without_earth():
    tie = LocalTie.from_launch(np.array([10.0, 20.0, 0.0]), None)
    assert tie.map_origin is None
    np.testing.assert_array_equal(tie.position_to_map(np.zeros(3)), [10.0, 20.0, 0.0])
    np.testing.assert_array_equal(
        tie.position_to_map(np.array([[5.0, 1.0, -2.0], [0.0, 0.0, 0.0]])),
        [[11.0, 25.0, 2.0], [10.0, 20.0, 0.0]],
    )
    np.testing.assert_array_equal(
        tie.velocity_to_local(np.array([1.0, 2.0, 3.0])), [2.0, 1.0, -3.0]
    )
    with pytest.raises(MapError, match="not tied to the earth"):
        tie.geodetic_to_map(PLACES["Zurich"])
    with pytest.raises(MapError, match="not tied to the earth"):
        tie.map_to_geodetic(np.zeros(3))


def test_launch_tie_knows_the_maps_corner():
    launch = np.array([10.0, 20.0, 0.0])
    tie = LocalTie.from_launch(launch, PLACES["Canberra"])
    assert tie.map_origin is not None
    np.testing.assert_allclose(tie.geodetic_to_map(tie.map_origin), np.zeros(3), atol=1e-6)
    np.testing.assert_allclose(tie.geodetic_to_map(PLACES["Canberra"]), launch, atol=1e-6)


def test_launch_tie_keeps_its_launch_point():
    launch = np.array([10.0, 20.0, 0.0])
    tie = LocalTie.from_launch(launch, None)
    launch += 5.0
    np.testing.assert_array_equal(tie.local_origin_enu_m, [10.0, 20.0, 0.0])


PX4_RADIUS_M = 6_371_000.0


def px4_local_ned_m(origin, point):
    """PX4's azimuthal equidistant projection on its sphere (lib/geo), written out here."""
    lat, lon, lat_0, lon_0 = np.radians(
        [point.latitude_deg, point.longitude_deg, origin.latitude_deg, origin.longitude_deg]
    )
    c = np.arccos(
        np.clip(
            np.sin(lat_0) * np.sin(lat) + np.cos(lat_0) * np.cos(lat) * np.cos(lon - lon_0), -1, 1
        )
    )
    k = c / np.sin(c) if c > 0 else 1.0
    north = k * (np.cos(lat_0) * np.sin(lat) - np.sin(lat_0) * np.cos(lat) * np.cos(lon - lon_0))
    east = k * np.cos(lat) * np.sin(lon - lon_0)
    down_m = origin.altitude_m - point.altitude_m
    return np.array([north * PX4_RADIUS_M, east * PX4_RADIUS_M, down_m])


@pytest.mark.parametrize("latitude_deg", [47.397742, -35.363261, 0.0, 65.0])
@pytest.mark.parametrize("offset_m", [(300.0, 0.0), (0.0, 300.0), (-400.0, 250.0)])
def test_the_sphere_of_an_autopilot_is_undone(latitude_deg, offset_m):
    corner = GeoPoint(latitude_deg, 8.5, 480.0)
    origin = enu_to_geodetic(corner, np.array([100.0, 80.0, 8.0]))
    true_enu_m = np.array([100.0 + offset_m[0], 80.0 + offset_m[1], 30.0])
    reported_ned_m = px4_local_ned_m(origin, enu_to_geodetic(corner, true_enu_m))
    tie = LocalTie.from_origins(corner, origin, earth_radius_m=PX4_RADIUS_M)
    np.testing.assert_allclose(tie.position_to_map(reported_ned_m)[:2], true_enu_m[:2], atol=0.01)
    np.testing.assert_allclose(
        tie.position_to_local(tie.position_to_map(reported_ned_m)), reported_ned_m, atol=1e-6
    )


def test_a_sphere_that_is_ignored_costs_a_metre_in_350():
    corner = GeoPoint(47.397742, 8.545594, 488.0)
    there_enu_m = np.array([350.0, 0.0, 0.0])
    reported_ned_m = px4_local_ned_m(corner, enu_to_geodetic(corner, there_enu_m))
    naive_enu_m = LocalTie.from_origins(corner, corner).position_to_map(reported_ned_m)
    assert abs(naive_enu_m[0] - there_enu_m[0]) > 1.0


def test_on_a_map_without_a_place_targets_share_the_autopilots_metres():
    origin = GeoPoint(47.397742, 8.545594, 488.0)
    tie = LocalTie.from_launch(np.array([10.0, 10.0, 0.0]), origin, earth_radius_m=PX4_RADIUS_M)
    target = enu_to_geodetic(origin, np.array([80.0, 60.0, 20.0]))
    np.testing.assert_allclose(
        tie.geodetic_to_map(target)[:2],
        tie.position_to_map(px4_local_ned_m(origin, target))[:2],
        atol=0.01,
    )
    there = tie.geodetic_to_map(target)
    np.testing.assert_allclose(tie.geodetic_to_map(tie.map_to_geodetic(there)), there, atol=1e-6)
    np.testing.assert_allclose(tie.geodetic_to_map(tie.map_origin), np.zeros(3), atol=0.01)
