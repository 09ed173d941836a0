"""The reasons against a flight, each on both sides of its border."""

import numpy as np
import pytest

from companion.positions import loose_tie
from companion.preflight import target_problem, target_warning, unhealthy, untimely
from companion.vehicle import FlightMode, LandedState, SystemStatus, VehicleState
from companion.world.maps import load_map

ENV1 = load_map("env1")  # obs1 stands from 12 to 28 m east, 60 to 76 m north, 60 m high


def state(**changes):
    values = {
        "time_s": 0.0,
        "position_ned_m": np.zeros(3),
        "velocity_ned_mps": np.zeros(3),
        "attitude_rad": np.zeros(3),
        "heartbeat_time_s": 0.0,
        "mode": FlightMode.HOLD,
        "mode_name": "AUTO.LOITER",
        "armed": False,
        "landed": LandedState.ON_GROUND,
        "system_status": SystemStatus.STANDBY,
        "ready_to_arm": True,
        "position_valid": True,
    }
    return VehicleState(**{**values, **changes})


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({}, []),
        ({"battery_fraction": 0.25}, []),
        ({"battery_fraction": 0.24}, ["battery at 24 %"]),
        ({"ready_to_arm": False}, ["the autopilot's own pre-arm checks do not pass"]),
        (
            {"ready_to_arm": False, "mode_name": "OFFBOARD"},
            [
                "the autopilot's own pre-arm checks do not pass: OFFBOARD wants a stream; select "
                "another mode, Hold for example"
            ],
        ),
        ({"ready_to_arm": False, "armed": True}, []),
        (
            {"system_status": SystemStatus.CRITICAL, "ready_to_arm": False},
            ["the autopilot is in a failsafe (CRITICAL)"],
        ),
    ],
)
def test_health(changes, says):
    assert unhealthy(state(**changes)) == says


def test_positions_must_come_often_and_fresh():
    assert untimely(10.0, 0.25) == ""
    assert "9.9 times a second" in untimely(9.9, 0.25)
    assert "0.26 s old" in untimely(10.0, 0.26)


def test_local_and_global_position_must_agree():
    assert loose_tie(None) == loose_tie(1.0) == ""
    assert "1.1 m apart" in loose_tie(1.1)


@pytest.mark.parametrize(
    ("target", "margin_m", "problem", "warning"),
    [
        ((8.0, 68.0, 30.0), 2.0, "", ""),
        ((11.5, 68.0, 30.0), 2.0, "", "no nearer to it than 2.0 m"),
        ((11.5, 68.0, 30.0), 0.4, "", ""),
        ((11.5, 68.0, 30.0), 8.0, "out of reach", None),  # the other side is the edge of the map
        ((20.0, 68.0, 60.5), 2.0, "", "no nearer to it than 2.0 m"),
        ((60.0, 20.0, 0.0), 2.0, "", "no nearer to it than 2.0 m"),
        ((60.0, 20.0, 99.0), 2.0, "", "no nearer to it than 1.0 m"),
        ((20.0, 68.0, 30.0), 2.0, "inside obstacle obs1", None),
        ((20.0, 68.0, 130.0), 2.0, "outside map", None),
    ],
)
def test_a_target_inside_the_margin(target, margin_m, problem, warning):
    place = np.array(target)
    found = target_problem(ENV1, place, margin_m)
    assert problem in found
    assert bool(problem) == bool(found)
    if warning is not None:
        said = target_warning(ENV1, place, margin_m)
        assert warning in said
        assert bool(warning) == bool(said)
