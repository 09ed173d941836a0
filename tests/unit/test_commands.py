"""What operators order over MAVLink is judged before it is acknowledged."""

import numpy as np
import pytest

from companion.commands import Commands
from companion.guidance.target import TargetTier
from companion.positions import Positions, TargetSource
from companion.vehicle import (
    CommandKind,
    FlightMode,
    LandedState,
    OperatorCommand,
    SystemStatus,
    VehicleState,
    Verdict,
)
from companion.world.frames import GeoPoint, LocalTie
from companion.world.maps import load_map

ENV1 = load_map("env1")
ORIGIN = GeoPoint(47.397742, 8.545594, 489.4)


def tied(source=None):
    positions = Positions(ENV1, source or TargetSource())
    state = VehicleState(
        time_s=1.0, position_ned_m=np.zeros(3), velocity_ned_mps=np.zeros(3),
        attitude_rad=np.zeros(3), heartbeat_time_s=1.0, mode=FlightMode.HOLD,
        mode_name="AUTO.LOITER", armed=False, landed=LandedState.ON_GROUND,
        system_status=SystemStatus.STANDBY, ready_to_arm=True, position_valid=True, origin=ORIGIN,
    )  # fmt: skip
    positions.update(state, {})
    return positions


def reposition(enu_m):
    tie = LocalTie.from_launch(ENV1.launch_enu_m, ORIGIN)
    point = tie.map_to_geodetic(np.array(enu_m, dtype=float))
    return OperatorCommand(CommandKind.REPOSITION, "255/190", point)


@pytest.mark.parametrize(
    ("enu_m", "verdict", "words"),
    [
        ((90.0, 10.0, 6.0), Verdict.ACCEPTED, ""),
        ((50.0, 48.0, 20.0), Verdict.DENIED, "obs2"),
        ((50.0, 480.0, 20.0), Verdict.DENIED, "outside"),
        ((50.0, 48.0, 500.0), Verdict.DENIED, "outside"),
    ],
)
def test_a_target_is_accepted_only_where_it_can_be_flown_to(enu_m, verdict, words):
    positions = tied()
    commands = Commands(ENV1, positions, target_given=False, margin_m=2.0)
    answer = commands.judge(reposition(enu_m))
    assert answer.verdict is verdict
    assert words in answer.words
    accepted = verdict is Verdict.ACCEPTED
    assert commands.take_target_changed() is accepted
    assert not commands.take_target_changed()
    estimate = positions.target(2.0)
    if accepted:
        np.testing.assert_allclose(estimate.position_enu_m, enu_m, atol=0.05)
    else:
        assert estimate.tier is TargetTier.NONE


def test_a_target_given_at_the_start_stays():
    source = TargetSource(np.array([10.0, 10.0, 5.0]))
    commands = Commands(ENV1, tied(source), target_given=True, margin_m=2.0)
    assert commands.judge(reposition((90.0, 10.0, 6.0))).verdict is Verdict.DENIED


def test_before_the_map_is_tied_a_target_has_to_wait():
    commands = Commands(ENV1, Positions(ENV1, TargetSource()), target_given=False, margin_m=2.0)
    assert commands.judge(reposition((90.0, 10.0, 6.0))).verdict is Verdict.NOT_NOW


def test_a_pause_is_for_good():
    commands = Commands(ENV1, tied(), target_given=False, margin_m=2.0)
    assert commands.judge(OperatorCommand(CommandKind.CONTINUE, "1/1")).verdict is Verdict.ACCEPTED
    assert commands.judge(OperatorCommand(CommandKind.PAUSE, "255/190")).verdict is Verdict.ACCEPTED
    assert commands.judge(OperatorCommand(CommandKind.PAUSE, "7/190")).verdict is Verdict.ACCEPTED
    assert commands.paused_by == "255/190"
    answer = commands.judge(OperatorCommand(CommandKind.CONTINUE, "255/190"))
    assert answer.verdict is Verdict.DENIED
    assert "start the program again" in answer.words
