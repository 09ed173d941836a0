"""What ArduCopter makes of SET_POSITION_TARGET_LOCAL_NED in GUIDED (``GCS_MAVLink_Copter.cpp``).

One ignored axis ignores the whole group of position, velocity or acceleration, and whatever it
cannot make sense of stops the vehicle (A2, A3, A4).
"""

import math

from sim.mock.dynamics import Vector
from sim.mock.estimator import add
from sim.mock.setpoints import (
    FORCE,
    MAV_FRAME_BODY_NED,
    MAV_FRAME_LOCAL_NED,
    NOTHING,
    YAW_IGNORE,
    YAW_RATE_IGNORE,
    Setpoint,
    turned,
)

MAV_FRAME_LOCAL_OFFSET_NED = 7
MAV_FRAME_BODY_OFFSET_NED = 9
BODY_FRAMES = (MAV_FRAME_BODY_NED, MAV_FRAME_BODY_OFFSET_NED)
FRAMES = (MAV_FRAME_LOCAL_NED, MAV_FRAME_LOCAL_OFFSET_NED, *BODY_FRAMES)
SANE = 1000.0
"""The largest velocity or acceleration that is believed."""


def group(values: Vector, type_mask: int, first_bit: int) -> Vector:
    """Return ``values``, or nothing if any axis of the group is ignored."""
    return NOTHING if type_mask >> first_bit & 0b111 else values


def read_setpoint(
    *,
    frame: int,
    type_mask: int,
    position_m: Vector,
    velocity_mps: Vector,
    acceleration_mps2: Vector,
    yaw_rad: float,
    yaw_rate_radps: float,
    here_m: Vector,
    heading_rad: float,
) -> Setpoint | None:
    """Interpret the fields of one message.

    Args:
        frame: MAV_FRAME.
        type_mask: POSITION_TARGET_TYPEMASK.
        position_m: x, y, z.
        velocity_mps: vx, vy, vz.
        acceleration_mps2: afx, afy, afz.
        yaw_rad: Heading; relative to the present one in the body frames (A5).
        yaw_rate_radps: Turn rate.
        here_m: The vehicle's own local position, which offsets are added to.
        heading_rad: The vehicle's own heading, which body frames are turned by.

    Returns:
        The setpoint in local NED, ``None`` where ArduCopter stops.
    """
    position = group(position_m, type_mask, 0)
    velocity = group(velocity_mps, type_mask, 3)
    acceleration = group(acceleration_mps2, type_mask, 6)
    has_position, has_velocity, has_acceleration = (
        not type_mask >> first_bit & 0b111 for first_bit in (0, 3, 6)
    )
    if frame not in FRAMES or (type_mask & FORCE and has_acceleration):
        return None
    if (has_velocity and not _sane(velocity)) or (has_acceleration and not _sane(acceleration)):
        return None
    if has_position and not all(map(math.isfinite, position)):
        return None
    if not has_velocity and has_position == has_acceleration:
        return None  # nothing at all, or a position with an acceleration
    if frame in BODY_FRAMES:
        position, velocity, acceleration = (
            turned(vector, heading_rad) for vector in (position, velocity, acceleration)
        )
    if frame != MAV_FRAME_LOCAL_NED and has_position:
        position = add(position, here_m)
    yaw = math.nan if type_mask & YAW_IGNORE else yaw_rad
    return Setpoint(
        position,
        velocity,
        acceleration,
        yaw + heading_rad if frame in BODY_FRAMES else yaw,
        math.nan if type_mask & YAW_RATE_IGNORE else yaw_rate_radps,
    )


def _sane(vector: Vector) -> bool:
    return all(math.isfinite(value) and abs(value) <= SANE for value in vector)
