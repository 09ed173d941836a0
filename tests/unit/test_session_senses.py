import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.policy.observation import LAYOUTS, NUM_RAYS, RAYS_RANGE_M, build_observation
from companion.session import colors
from companion.session.earth_view import _to_earth
from companion.session.motion import clearance_color, painter
from companion.session.records import ActorRecord, MapRecord, SessionStart, Tick, VehicleRecord
from companion.session.senses import Senses
from companion.world.frames import GeoPoint, geodetic_to_enu
from companion.world.maps import load_map
from companion.world.way_ahead import WayAhead

CITY = load_map("env1")
places = st.tuples(st.floats(2, 98), st.floats(2, 98), st.floats(1, 95)).map(np.array)


def look(layout_name, position_m, target_m, ahead=None):
    layout = LAYOUTS[layout_name]
    observation = build_observation(
        layout,
        position_enu_m=position_m,
        velocity_enu_mps=np.zeros(3),
        target_enu_m=target_m,
        map=CITY,
        ahead=ahead,
    )
    tick = Tick(
        time_s=0.0,
        position_enu_m=position_m.tolist(),
        target_enu_m=target_m.tolist(),
        observation=observation.tolist(),
    )
    return Senses(layout.name, list(layout.columns)).look(tick)


@settings(deadline=None, max_examples=50)
@given(places, places)
def test_rays_end_on_walls(position_m, target_m):
    seen = look("rays", position_m, target_m)
    if math.dist(position_m[:2], target_m[:2]) < 0.5:
        assert seen is None
        return
    assert len(seen.rays_m) <= NUM_RAYS
    np.testing.assert_allclose(seen.rays_m[:, 0], np.tile(position_m, (len(seen.rays_m), 1)))
    lengths_m = np.linalg.norm(seen.rays_m[:, 1] - seen.rays_m[:, 0], axis=-1)
    assert (lengths_m < RAYS_RANGE_M).all()
    if CITY.obstacles.signed_distance_m(position_m) > 0.0:
        beside_m = CITY.obstacles.signed_distance_m(seen.rays_m[:, 1])
        np.testing.assert_allclose(beside_m, 0.0, atol=0.02)


@settings(deadline=None, max_examples=50)
@given(places, places, places, places)
def test_the_way_is_drawn_where_it_was_shown(position_m, target_m, aim_m, beyond_m):
    beyond_m = aim_m + 0.1 * (beyond_m - aim_m)
    if min(math.dist(position_m[:2], at[:2]) for at in (target_m, aim_m)) < 1.0:
        return
    ahead = WayAhead(aim_m, beyond_m, np.array(50.0), np.array(True))
    seen = look("ways", position_m, target_m, ahead)
    np.testing.assert_allclose(seen.way_m[0], position_m)
    if math.dist(position_m, target_m) < 90.0 and math.dist(position_m, aim_m) < 90.0:
        np.testing.assert_allclose(seen.way_m[1], aim_m, atol=0.02)
        np.testing.assert_allclose(seen.way_m[2], beyond_m, atol=0.02)


def test_a_layout_without_rays_draws_nothing():
    paper = Senses("paper", list(LAYOUTS["paper"].columns))
    assert not paper.sees
    assert paper.look(Tick(time_s=0.0, observation=[0.0] * 6)) is None


def test_what_cannot_be_placed_is_not_drawn():
    senses = Senses("rays", list(LAYOUTS["rays"].columns))
    blind = [0.5] * len(LAYOUTS["rays"].columns)
    assert senses.look(Tick(time_s=0.0)) is None
    assert senses.look(Tick(time_s=0.0, position_enu_m=[1.0, 2.0, 3.0], observation=blind)) is None


def test_a_map_on_earth_is_drawn_where_it_lies():
    record = MapRecord("m", [800.0, 600.0, 100.0], origin=[47.37, 8.54, 410.0])
    corner, per_metre = _to_earth(record)
    place = corner + np.array([400.0, 300.0]) @ per_metre
    point = GeoPoint(float(place[0]), float(place[1]), 410.0)
    found_m = geodetic_to_enu(GeoPoint(47.37, 8.54, 410.0), point)
    np.testing.assert_allclose(found_m[:2], [400.0, 300.0], atol=0.1)
    assert _to_earth(MapRecord("m", [1.0, 1.0, 1.0])) is None


@pytest.mark.parametrize(
    ("clearance_m", "color"),
    [(None, colors.IDLE), (1.9, colors.DANGER), (math.inf, colors.MEASURED), (2.0, colors.DANGER)],
)
def test_the_plan_is_coloured_by_clearance(clearance_m, color):
    assert clearance_color(Tick(time_s=0.0, clearance_m=clearance_m), 2.0) == color


def test_a_log_is_coloured_by_flight_mode():
    start = SessionStart(
        session_id="s",
        start_utc_us=0,
        map=MapRecord("m", [1.0, 1.0, 1.0]),
        actor=ActorRecord(""),
        vehicle=VehicleRecord(1, "px4"),
        config={},
        v_max_mps=1.0,
        margin_m=0.0,
        arrival_radius_m=1.0,
    )
    paint = painter(start)
    offboard, pilot = (paint(Tick(time_s=0.0, mode=mode)) for mode in ("OFFBOARD", "POSCTL"))
    assert offboard != pilot
    assert paint(Tick(time_s=9.0, mode="OFFBOARD")) == offboard
