import math

import numpy as np
import pytest
import shapely

from companion.session.curves import CURVES, DISTANCE, SPEED
from companion.session.records import (
    ActorRecord,
    MapRecord,
    Mark,
    SessionStart,
    Tick,
    VehicleRecord,
)
from companion.session.scene import _roof, _walls, marks
from companion.session.views import SLOPE_ACROSS as _SLOPE_ACROSS
from companion.session.views import SLOPE_UP as _SLOPE_UP
from companion.session.views import stand_back as _stand_back

SQUARE = [[0, 0], [4, 0], [4, 4], [0, 4]]
L_SHAPE = [[0, 0], [4, 0], [4, 1], [1, 1], [1, 4], [0, 4]]
STAR = [
    [r * math.cos(a), r * math.sin(a)]
    for r, a in zip([5, 2] * 5, np.linspace(0, 2 * math.pi, 11)[:-1], strict=True)
]
START = SessionStart(
    session_id="s",
    start_utc_us=0,
    map=MapRecord("m", [100.0, 100.0, 50.0]),
    actor=ActorRecord("a"),
    vehicle=VehicleRecord(1, "px4"),
    config={},
    v_max_mps=4.0,
    margin_m=2.0,
    arrival_radius_m=5.0,
)


@pytest.mark.parametrize("ring", [SQUARE, L_SHAPE, STAR], ids=["square", "concave", "star"])
@pytest.mark.parametrize("turn", [1, -1], ids=["counter-clockwise", "clockwise"])
def test_a_prism_is_closed_and_faces_outward(ring, turn):
    footprint_m = np.array(ring, dtype=float)[::turn]
    polygon = shapely.Polygon(footprint_m)
    corners_m, triangles = _roof(footprint_m, 7.0)
    first, second, third = (corners_m[triangles[:, k]] for k in range(3))
    up = np.cross(second - first, third - first)
    assert (up[:, 2] > 0.0).all()
    assert 0.5 * up[:, 2].sum() == pytest.approx(polygon.area)
    assert (corners_m[:, 2] == 7.0).all()
    walls = list(_walls(footprint_m, 7.0))
    assert len(walls) == len(ring)
    for wall_m, normal in walls:
        middle_m = wall_m.mean(axis=0)[:2]
        assert not polygon.contains(shapely.Point(middle_m + 0.01 * normal[:2]))
        assert polygon.contains(shapely.Point(middle_m - 0.01 * normal[:2]))


def test_a_ring_that_repeats_its_first_corner_is_the_same_prism():
    closed = np.array([*SQUARE, SQUARE[0]], dtype=float)
    assert len(list(_walls(closed, 7.0))) == len(SQUARE)


@pytest.mark.parametrize("size_m", [(100, 100, 100), (500, 80, 30), (60, 400, 200)])
def test_the_city_camera_sees_everything(size_m):
    corners_m = np.stack(np.meshgrid(*[[0.0, float(side)] for side in size_m]), -1).reshape(-1, 3)
    eye_m, target_m = _stand_back(corners_m)
    ahead = (target_m - eye_m) / np.linalg.norm(target_m - eye_m)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    above = np.cross(right, ahead)
    depth_m = (corners_m - eye_m) @ ahead
    across = np.abs((corners_m - eye_m) @ right) / depth_m
    up = np.abs((corners_m - eye_m) @ above) / depth_m
    assert (depth_m > 0.0).all()
    assert across.max() <= _SLOPE_ACROSS + 1e-9
    assert up.max() <= _SLOPE_UP + 1e-9
    assert max(across.max() / _SLOPE_ACROSS, up.max() / _SLOPE_UP) == pytest.approx(1.0)


def test_a_curve_leaves_out_what_is_not_known():
    ticks = [
        Tick(time_s=0.0),
        Tick(time_s=0.1, velocity_enu_mps=[3.0, 4.0, 0.0]),
        Tick(time_s=0.2, velocity_enu_mps=[0.0, 0.0, 0.0], safe_enu_mps=[0.0, 2.0, 0.0]),
    ]
    time_s, values = SPEED.rows(ticks, START)
    np.testing.assert_array_equal(time_s, [0.1, 0.2])
    np.testing.assert_array_equal(values, [[4.0, np.nan, 5.0], [4.0, 2.0, 0.0]])


def test_infinity_is_a_gap():
    time_s, _ = DISTANCE.rows([Tick(time_s=0.0, distance_m=math.inf)], START)
    assert len(time_s) == 1  # the arrival radius is still drawn


@pytest.mark.parametrize("curve", CURVES, ids=lambda curve: curve.title)
def test_every_curve_has_a_value_for_each_line_or_none_at_all(curve):
    full = Tick(
        time_s=0.0,
        position_enu_m=[1.0, 2.0, 3.0],
        velocity_enu_mps=[1.0, 2.0, 3.0],
        target_enu_m=[1.0, 2.0, 3.0],
        action=[0.1, 0.2, 0.3],
        spherical=[0.1, 0.2, 0.3],
        proposed_enu_mps=[1.0, 2.0, 3.0],
        safe_enu_mps=[1.0, 2.0, 3.0],
        clearance_m=1.0,
        distance_m=1.0,
        battery_fraction=0.5,
        link_age_s=0.1,
        position_age_s=0.1,
        target_age_s=0.1,
        latency_ms=1.0,
        lateness_ms=1.0,
    )
    _, values = curve.rows([full], START)
    assert values.shape == (1, len(curve.lines))
    assert np.isfinite(values).all()
    time_s, _ = curve.rows([Tick(time_s=0.0)], START)
    assert len(time_s) == 0


def test_marks_of_one_place_share_a_label_and_say_nothing_twice():
    records = [
        Mark("engaged [engaged]", [10.0, 10.0, 20.0]),
        Mark("stood down [failsafe]", [60.0, 40.0, 20.0]),
        Mark("closest to an obstacle", [62.0, 40.0, 20.0]),
        Mark("handing over [no_progress]", [90.0, 50.0, 40.0]),
    ]
    points = marks(records, 100.0)
    assert points.labels.as_arrow_array().to_pylist() == [
        "engaged",
        "stood down: failsafe\nclosest",
        "no progress",
    ]
