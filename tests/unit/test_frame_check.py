"""Local against global position: the link measures, ``Positions`` doubts, the origin is asked."""

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.positions import APART_S, Positions, TargetSource
from companion.vehicle import FRAME_RESIDUAL_M
from companion.world.frames import GeoPoint, LocalTie
from companion.world.maps import load_map

ORIGIN = GeoPoint(47.397742, 8.545594, 489.4)
PX4_RADIUS_M = 6_371_000.0
HERE_NED_M = np.array([30.0, -20.0, -12.0])


def on_earth(position_ned_m):
    tie = LocalTie.from_launch(np.zeros(3), ORIGIN, earth_radius_m=PX4_RADIUS_M)
    return tie.map_to_geodetic(tie.position_to_map(np.asarray(position_ned_m, dtype=float)))


def flow(bench, duration_s, *, local=HERE_NED_M, globally=HERE_NED_M, velocity=0.0, late_ms=0):
    """Let both positions come, ten times a second."""
    point = on_earth(globally)
    end_s = bench.transport.now_s + duration_s
    while bench.transport.now_s < end_s - 1e-6:
        boot_ms = round((bench.transport.now_s - 900.0) * 1e3)
        bench.position(boot_ms=boot_ms, x=local[0], y=local[1], z=local[2], vx=velocity)
        bench.autopilot.send(
            dialect.MAVLink_global_position_int_message(
                boot_ms + late_ms, round(point.latitude_deg * 1e7),
                round(point.longitude_deg * 1e7), round(point.altitude_m * 1e3), 0, 0, 0, 0, 0,
            )
        )  # fmt: skip
        bench.run(0.1)
    return bench.vehicle.state()


@pytest.fixture
def flying(bench):
    bench.attach()
    bench.flying()
    return bench


def test_positions_of_one_place_agree_to_centimetres(flying):
    assert flow(flying, 1.0).frame_residual_m < 0.03


@pytest.mark.parametrize("metres", [0.5, 3.0, 200.0])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_difference_is_measured_on_every_axis(flying, axis, metres):
    there = HERE_NED_M + metres * np.eye(3)[axis]
    assert flow(flying, 1.0, globally=there).frame_residual_m == pytest.approx(metres, abs=0.05)


def test_the_way_between_two_messages_is_not_a_difference(flying):
    """A global position 0.2 s younger than the local one, at 10 m/s: two metres are no doubt."""
    there = HERE_NED_M + np.array([2.0, 0.0, 0.0])
    state = flow(flying, 1.0, globally=there, velocity=10.0, late_ms=200)
    assert state.frame_residual_m < 0.05


def test_without_origin_or_global_position_nothing_is_known(bench):
    bench.attach()
    bench.position()
    bench.attitude()
    bench.run()
    assert bench.vehicle.state().frame_residual_m is None


def test_an_old_comparison_is_forgotten(flying):
    assert flow(flying, 1.0).frame_residual_m is not None
    flying.run(4.0)
    assert flying.vehicle.state().frame_residual_m is None


def test_the_origin_is_asked_for_again_while_the_two_are_apart(flying):
    flow(flying, 3.0)
    flying.transport.sent.clear()
    flow(flying, 3.0, globally=HERE_NED_M + 5.0)
    asked = [message.param1 for message in flying.commands(dialect.MAV_CMD_REQUEST_MESSAGE)]
    assert asked.count(dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN) >= 2


def test_a_new_origin_settles_it(flying):
    """The local origin moves, and its message was lost; it is asked for, and all is well."""
    flow(flying, 1.0)
    moved = on_earth([10.0, 0.0, 0.0])
    state = flow(flying, 1.0, local=HERE_NED_M - [10.0, 0.0, 0.0])
    assert state.frame_residual_m == pytest.approx(10.0, abs=0.1)
    epoch = state.frame_epoch
    flying.origin(
        round(moved.latitude_deg * 1e7),
        round(moved.longitude_deg * 1e7),
        round(moved.altitude_m * 1e3),
    )
    state = flow(flying, 1.0, local=HERE_NED_M - [10.0, 0.0, 0.0])
    assert state.frame_epoch == epoch + 1
    assert state.frame_residual_m < 0.05


def test_a_moment_apart_is_no_doubt_and_longer_is(flying):
    positions = Positions(load_map("free"), TargetSource(), earth_radius_m=PX4_RADIUS_M)

    def look(duration_s, **where):
        state = flow(flying, duration_s, **where)
        positions.update(state, {})
        return positions.untied

    assert not look(0.5)
    apart = {"globally": HERE_NED_M + (FRAME_RESIDUAL_M + 0.5) * np.eye(3)[0]}
    assert not look(0.3, **apart)
    assert "1.5 m apart" in look(APART_S + 0.3, **apart)
    assert not look(0.5)
