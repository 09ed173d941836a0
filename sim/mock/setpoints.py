"""A setpoint, as the fields of SET_POSITION_TARGET_LOCAL_NED say it."""

import math
from dataclasses import dataclass, field

from sim.mock.dynamics import Vector

MAV_FRAME_LOCAL_NED = 1
MAV_FRAME_BODY_NED = 8

FORCE = 0x200
YAW_IGNORE = 0x400
YAW_RATE_IGNORE = 0x800

EVERY_AXIS = 0b111
NOTHING: Vector = (math.nan, math.nan, math.nan)


@dataclass(frozen=True, slots=True)
class Setpoint:
    """A setpoint in local NED; NaN means not controlled."""

    position_m: Vector = NOTHING
    velocity_mps: Vector = NOTHING
    acceleration_mps2: Vector = NOTHING
    yaw_rad: float = math.nan
    yaw_rate_radps: float = math.nan
    complete: bool = field(init=False)
    """Whether every axis is controlled by something; else PX4 stays where it is."""
    only_velocity: bool = field(init=False)
    """Whether all of the velocity is controlled, and nothing of position and acceleration."""
    counts_as_stream: bool = field(init=False)
    """Whether anything is controlled at all: only then it feeds the offboard watchdog."""

    def __post_init__(self) -> None:
        """Note once what is asked at every step."""
        p, v, a = map(_known, (self.position_m, self.velocity_mps, self.acceleration_mps2))
        object.__setattr__(self, "complete", (p | v | a) == EVERY_AXIS)
        object.__setattr__(self, "only_velocity", v == EVERY_AXIS and not p | a)
        object.__setattr__(self, "counts_as_stream", p | v | a > 0)

    @property
    def climbs(self) -> bool:
        """Whether the velocity or acceleration points up: reason to take off."""
        return self.velocity_mps[2] < 0.0 or self.acceleration_mps2[2] < 0.0


def _known(vector: Vector) -> int:
    """Return a bit for each axis that has a number."""
    x, y, z = vector
    return math.isfinite(x) | math.isfinite(y) << 1 | math.isfinite(z) << 2


def masked(values: Vector, type_mask: int, first_bit: int) -> Vector:
    """Return ``values`` with the axes ignored by ``type_mask`` replaced by NaN."""
    if not type_mask >> first_bit & 0b111:
        return values
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
