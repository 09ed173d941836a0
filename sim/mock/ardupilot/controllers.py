"""Pieces of ArduCopter's controllers: nearing a point, turning the nose, keeping off the fence."""

import math

from sim.mock.ardupilot.failsafe import FENCE_CIRCLE
from sim.mock.dynamics import PointMass, Vector, wrap_pi
from sim.mock.estimator import subtract
from sim.mock.parameters import Parameters
from sim.mock.setpoints import Setpoint

APPROACH_XY_MPS2 = 1.5
APPROACH_Z_MPS2 = 0.55
"""Decelerations when nearing a point, fitted to recorded returns and take-offs."""
GAIN_XY_PER_S, GAIN_Z_PER_S = 1.0, 0.7
YAW_GAIN_PER_S = 4.0
LOOK_AHEAD_MPS = 0.95
"""Slower than this the nose stays; ArduPilot says 1 m/s, and 1 m/s eastward turned it."""
AVOID_USES_FENCE = 1
AVOID_MPS2 = 1.0


def toward(point_m: Vector, here_m: Vector, speed_mps: float) -> Vector:
    """Return the velocity that nears ``point_m`` and stops there."""
    north, east, down = subtract(point_m, here_m)
    distance = math.hypot(north, east)
    level = min(speed_mps, _braked(distance, APPROACH_XY_MPS2, GAIN_XY_PER_S))
    share = level / distance if distance > 0.0 else 0.0
    vertical = math.copysign(_braked(abs(down), APPROACH_Z_MPS2, GAIN_Z_PER_S), down)
    return north * share, east * share, vertical


def heading_rate(body: PointMass, setpoint: Setpoint | None, slew_radps: float) -> float:
    """Return how fast to turn: as asked, or into the direction of travel where yaw is free."""
    wanted = math.nan
    if setpoint is not None:
        if math.isfinite(setpoint.yaw_rate_radps):
            return max(-slew_radps, min(slew_radps, setpoint.yaw_rate_radps))
        wanted = setpoint.yaw_rad
    north, east, _ = body.velocity_mps
    if not math.isfinite(wanted):
        if setpoint is None or math.hypot(north, east) < LOOK_AHEAD_MPS:
            return 0.0
        wanted = math.atan2(east, north)
    rate = YAW_GAIN_PER_S * wrap_pi(wanted - body.yaw_rad)
    return max(-slew_radps, min(slew_radps, rate))


def avoid_fence(
    velocity_mps: Vector, here_m: Vector, home_m: Vector, parameters: Parameters
) -> Vector:
    """Slow down before the circle fence (A8): AVOID_ENABLE guards velocity setpoints too."""
    if not (
        parameters.number("FENCE_ENABLE")
        and int(parameters.number("FENCE_TYPE")) & FENCE_CIRCLE
        and int(parameters.number("AVOID_ENABLE")) & AVOID_USES_FENCE
    ):
        return velocity_mps
    north, east, down = velocity_mps
    out_north, out_east, _ = subtract(here_m, home_m)
    distance = math.hypot(out_north, out_east)
    if distance == 0.0:
        return velocity_mps
    out_north, out_east = out_north / distance, out_east / distance
    outward = north * out_north + east * out_east
    room = parameters.number("FENCE_RADIUS") - parameters.number("FENCE_MARGIN") - distance
    excess = max(0.0, outward - _braked(max(0.0, room), AVOID_MPS2, GAIN_XY_PER_S))
    return north - excess * out_north, east - excess * out_east, down


def _braked(distance_m: float, deceleration_mps2: float, gain_per_s: float) -> float:
    """Return the speed from which the deceleration and the gain stop within a distance."""
    return min(gain_per_s * distance_m, math.sqrt(2.0 * deceleration_mps2 * distance_m))
