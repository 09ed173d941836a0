"""The reasons against a flight, each on both sides of its border."""

import numpy as np
import pytest

from companion.positions import loose_tie
from companion.preflight import unhealthy, untimely
from companion.vehicle import FlightMode, LandedState, SystemStatus, VehicleState


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
