"""Why ArduCopter will not change to a mode, or arm: the reasons as it words them."""

from sim.mock.ardupilot.estimator import PREARM_S, CopterEstimator
from sim.mock.ardupilot.modes import Mode


def mode_problem(
    mode: Mode | None, *, blocked: int, armed: bool, position_good: bool
) -> str | None:
    """Return what speaks against a mode (A11); disarmed, hardly anything does.

    Args:
        mode: ``None`` for one that ArduCopter knows and the mock does not imitate.
        blocked: FLTMODE_GCSBLOCK, where a ground station asks.
        armed: Whether the motors are armed.
        position_good: Whether modes that need a position may be flown.
    """
    if mode is None:
        return "init failed"
    if blocked & mode.block_bit:
        return "GCS entry disabled (FLTMODE_GCSBLOCK)"
    if not armed:
        return None
    if mode.requires_position and not position_good:
        return "requires position"
    return "init failed" if mode is Mode.AUTO else None  # no mission is ever loaded


def prearm_problem(
    estimator: CopterEstimator, now_s: float, mode: Mode, *, initialised: bool
) -> str | None:
    """Return which of the pre-arm checks fails: SYS_STATUS PREARM_CHECK (A12)."""
    if not initialised:
        return "System not initialised"
    if mode.requires_position and not estimator.ready(now_s):
        return "Need Position Estimate"
    if now_s < estimator.at(PREARM_S):
        return "AHRS: waiting for home"
    return None


def arming_problem(mode: Mode) -> str | None:
    """Return what speaks against arming although the pre-arm checks pass (A10)."""
    return None if mode.allows_arming else f"{mode.name} mode not armable"
