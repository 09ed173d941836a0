"""A setpoint, as the fields of SET_POSITION_TARGET_LOCAL_NED say it."""

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


def turned(vector: Vector, heading_rad: float) -> Vector:
    """Turn a vector from forward-right-down to north-east-down by yaw alone."""
    forward, right, down = vector
    cos, sin = math.cos(heading_rad), math.sin(heading_rad)
    return cos * forward - sin * right, sin * forward + cos * right, down
