"""What PX4 makes of SET_POSITION_TARGET_LOCAL_NED (``mavlink_receiver.cpp``).

A masked axis and a NaN value mean the same: not controlled. The message counts as a sign of
life if any axis of position, velocity or acceleration is controlled; it moves the vehicle only
if every axis is.
"""

import math

from sim.mock.dynamics import Vector
from sim.mock.setpoints import (
    FORCE,
    MAV_FRAME_BODY_NED,
    MAV_FRAME_LOCAL_NED,
    NOTHING,
    YAW_IGNORE,
    YAW_RATE_IGNORE,
    Setpoint,
    masked,
    turned,
)


def read_setpoint(
    name: str,
    *,
    frame: int,
    type_mask: int,
    position_m: Vector,
    velocity_mps: Vector,
    acceleration_mps2: Vector,
    yaw_rad: float,
    yaw_rate_radps: float,
    heading_rad: float,
) -> Setpoint | str:
    """Interpret the fields of one message.

    Args:
        name: Name of the message, for the text.
        frame: MAV_FRAME; only LOCAL_NED and BODY_NED exist for a copter.
        type_mask: POSITION_TARGET_TYPEMASK.
        position_m: x, y, z.
        velocity_mps: vx, vy, vz.
        acceleration_mps2: afx, afy, afz.
        yaw_rad: Heading.
        yaw_rate_radps: Turn rate.
        heading_rad: The vehicle's own heading, to turn BODY_NED by.

    Returns:
        The setpoint, or the text PX4 prints when it drops the message.
    """
    position_m = masked(position_m, type_mask, 0)
    velocity_mps = masked(velocity_mps, type_mask, 3)
    acceleration_mps2 = masked(acceleration_mps2, type_mask, 6)
    if frame == MAV_FRAME_BODY_NED:
        position_m = NOTHING
        velocity_mps = turned(velocity_mps, heading_rad)
        acceleration_mps2 = turned(acceleration_mps2, heading_rad)
    elif frame != MAV_FRAME_LOCAL_NED:
        return f"{name} coordinate frame {frame} unsupported"
    setpoint = Setpoint(
        position_m,
        velocity_mps,
        acceleration_mps2,
        math.nan if type_mask & YAW_IGNORE else yaw_rad,
        math.nan if type_mask & YAW_RATE_IGNORE else yaw_rate_radps,
    )
    if type_mask & FORCE and any(map(math.isfinite, acceleration_mps2)):
        return f"{name} force not supported"
    return setpoint if setpoint.counts_as_stream else f"{name} invalid"
