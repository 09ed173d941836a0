"""What PX4 makes of SET_POSITION_TARGET_LOCAL_NED (``mavlink_receiver.cpp``).

A masked axis and a NaN value mean the same: not controlled. The message counts as a sign of
life if any axis of position, velocity or acceleration is controlled; it moves the vehicle only
if every axis is.
"""

import math
from dataclasses import dataclass

from sim.mock.dynamics import Vector

MAV_FRAME_LOCAL_NED = 1
MAV_FRAME_BODY_NED = 8

FORCE = 0x200
YAW_IGNORE = 0x400
YAW_RATE_IGNORE = 0x800

NOTHING: Vector = (math.nan, math.nan, math.nan)


@dataclass(frozen=True, slots=True)
class Setpoint:
    """A setpoint in local NED; NaN means not controlled."""

    position_m: Vector = NOTHING
    velocity_mps: Vector = NOTHING
    acceleration_mps2: Vector = NOTHING
    yaw_rad: float = math.nan
    yaw_rate_radps: float = math.nan

    @property
    def counts_as_stream(self) -> bool:
        """Whether anything is controlled at all: only then it feeds the offboard watchdog."""
        return any(
            math.isfinite(value)
            for value in (*self.position_m, *self.velocity_mps, *self.acceleration_mps2)
        )

    @property
    def complete(self) -> bool:
        """Whether every axis is controlled by something; else PX4 stays where it is."""
        return all(
            math.isfinite(p) or math.isfinite(v) or math.isfinite(a)
            for p, v, a in zip(
                self.position_m, self.velocity_mps, self.acceleration_mps2, strict=True
            )
        )

    @property
    def climbs(self) -> bool:
        """Whether the velocity or acceleration points up: reason to take off."""
        return self.velocity_mps[2] < 0.0 or self.acceleration_mps2[2] < 0.0


def masked(values: Vector, type_mask: int, first_bit: int) -> Vector:
    """Return ``values`` with the axes ignored by ``type_mask`` replaced by NaN."""
    north, east, down = (
        math.nan if type_mask >> (first_bit + axis) & 1 else value
        for axis, value in enumerate(values)
    )
    return north, east, down


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


def turned(vector: Vector, heading_rad: float) -> Vector:
    """Turn a vector from forward-right-down to north-east-down by yaw alone."""
    forward, right, down = vector
    cos, sin = math.cos(heading_rad), math.sin(heading_rad)
    return cos * forward - sin * right, sin * forward + cos * right, down
