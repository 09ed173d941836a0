import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.session import colors
from companion.session.motion import Course, Path, attitude_enu, path_color
from companion.session.records import Tick

angles = st.floats(-math.pi, math.pi)


def rotate(quaternion_xyzw, vector):
    x, y, z, w = quaternion_xyzw
    axis = np.array([x, y, z])
    return vector + 2.0 * np.cross(axis, np.cross(axis, vector) + w * vector)


def ned_from_body(roll, pitch, yaw):
    """Rotation matrix of MAVLink's ATTITUDE, by definition: yaw, then pitch, then roll."""
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (math.cos, math.sin))
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    return about_z @ about_y @ about_x


@given(angles, st.floats(-1.5, 1.5), angles)
def test_attitude_turns_the_same_way_as_in_ned(roll, pitch, yaw):
    quaternion = attitude_enu(np.array([roll, pitch, yaw]))
    in_ned = ned_from_body(roll, pitch, yaw)
    for flu, frd in (([1, 0, 0], [1, 0, 0]), ([0, 1, 0], [0, -1, 0]), ([0, 0, 1], [0, 0, -1])):
        north, east, down = in_ned @ np.array(frd, dtype=float)
        enu = rotate(quaternion, np.array(flu, dtype=float))
        np.testing.assert_allclose(enu, [east, north, -down], atol=1e-9)


@pytest.mark.parametrize(
    ("yaw_rad", "nose"),
    [(0.0, [0, 1, 0]), (math.pi / 2, [1, 0, 0]), (math.pi, [0, -1, 0])],
    ids=["north", "east", "south"],
)
def test_the_nose_points_where_the_compass_says(yaw_rad, nose):
    quaternion = attitude_enu(np.array([0.0, 0.0, yaw_rad]))
    np.testing.assert_allclose(rotate(quaternion, np.array([1.0, 0.0, 0.0])), nose, atol=1e-12)


def test_batches_agree_with_single_attitudes():
    attitude_rad = np.random.default_rng(0).uniform(-3.0, 3.0, (20, 3))
    each = [attitude_enu(row) for row in attitude_rad]
    np.testing.assert_array_equal(attitude_enu(attitude_rad), each)


def test_the_course_is_the_nose_until_the_vehicle_moves():
    course = Course()
    still = Tick(time_s=0.0, velocity_enu_mps=[0.0, 0.0, 0.0], attitude_rad=[0.0, 0.0, 0.0])
    assert course.update(still) == pytest.approx(math.pi / 2)
    for index in range(200):
        west = Tick(time_s=index / 20, velocity_enu_mps=[-3.0, 0.0, 0.0])
        course_rad = course.update(west)
    assert abs(course_rad) == pytest.approx(math.pi)


def test_a_path_has_no_gaps_and_no_crumbs():
    path = Path()
    positions_m = [[0.1 * index, 0.0, 5.0] for index in range(100)]
    pieces = [path.extend(0.05 * i, at_m, colors.SENT) for i, at_m in enumerate(positions_m)]
    pieces = [piece for piece in [*pieces, path.finish()] if piece is not None]
    assert 4 <= len(pieces) <= 6
    assert pieces[0].points_m[0] == positions_m[0]
    assert all(len(piece.points_m) <= 7 for piece in pieces)
    for before, after in itertools.pairwise(pieces):
        assert before.points_m[-1] == after.points_m[0]
        assert before.time_s < after.time_s


def test_the_colour_of_a_path_changes_where_it_changed():
    path = Path()
    shades = [colors.MEASURED] * 20 + [colors.SHIELDED] + [colors.MEASURED] * 20
    pieces = [path.extend(0.05 * i, [0.25 * i, 0.0, 5.0], c) for i, c in enumerate(shades)]
    pieces = [piece for piece in [*pieces, path.finish()] if piece is not None]
    (orange,) = (piece for piece in pieces if piece.color == colors.SHIELDED)
    assert orange.points_m[0][0] == pytest.approx(4.5)  # a tick long, but seen
    assert orange.points_m[-1][0] == pytest.approx(5.0)


def test_a_vehicle_that_hovers_draws_nothing():
    path = Path()
    assert [path.extend(float(i), [1.0, 2.0, 3.0], colors.SENT) for i in range(50)] == [None] * 50


@pytest.mark.parametrize(
    ("tick", "color"),
    [
        (Tick(time_s=0.0), colors.IDLE),
        (Tick(time_s=0.0, safe_enu_mps=[0.0, 0.0, 0.0]), colors.IDLE),
        (Tick(time_s=0.0, safe_enu_mps=[0.0, 0.0, 1.0]), colors.MEASURED),
        (Tick(time_s=0.0, safe_enu_mps=[0.0, 0.0, 1.0], clearance_m=2.0), colors.MEASURED),
        (Tick(time_s=0.0, safe_enu_mps=[0.0, 0.0, 1.0], intervened=True), colors.SHIELDED),
        (Tick(time_s=0.0, intervened=True, clearance_m=1.9), colors.DANGER),
    ],
    ids=["nothing sent", "zero", "policy", "on the margin", "shield", "inside"],
)
def test_the_colour_of_the_path_says_who_decided(tick, color):
    assert path_color(tick, margin_m=2.0) == color
