"""How a vehicle moves: the paper's kinematic point, and one that needs time to follow.

Pure and batched: ``(3,)`` and ``(N, 3)`` alike, map frame or NED alike.
"""

import math
from dataclasses import dataclass

import numpy as np

from companion.arrays import FloatArray


@dataclass(frozen=True, slots=True)
class VelocityLag:
    """How fast an autopilot follows a velocity setpoint."""

    time_constant_s: float = 0.5
    """Of the first-order response. Measured over a step to 2 m/s in SITL, 1.5 s after it:
    ArduCopter 4.6 at 1.85 m/s (0.58 s), PX4 1.18 at 86 % of what it settles to (0.76 s)."""
    acceleration_max_mps2: float = 4.0
    """Largest change of velocity; between PX4's MPC_ACC_HOR (3) and MPC_ACC_HOR_MAX (5). What
    was recorded is slower: the lag and limit that explain most of steps of 2 and 3 m/s are 0.44 s
    and 1.6 m/s2 on ArduCopter 4.6, 0.72 s and 2.5 m/s2 on PX4 1.18, which falls 14 % short."""

    def __post_init__(self) -> None:
        if not self.time_constant_s > 0.0:
            raise ValueError(f"time_constant_s must be positive, got {self.time_constant_s}")
        if not self.acceleration_max_mps2 > 0.0:
            raise ValueError(
                f"acceleration_max_mps2 must be positive, got {self.acceleration_max_mps2}"
            )


@dataclass(frozen=True, slots=True)
class Disturbance:
    """A random quantity that wanders around zero (a first-order Gauss-Markov process).

    As wind, it is the ground velocity that gusts leave over after the autopilot has worked
    against them, in m/s. As position noise, it is the error of the estimate, in metres.
    """

    std: float
    """Standard deviation on each axis."""
    correlation_s: float
    """Time after which 1/e of it is left."""

    def __post_init__(self) -> None:
        if not self.std >= 0.0:
            raise ValueError(f"std must not be negative, got {self.std}")
        if not self.correlation_s > 0.0:
            raise ValueError(f"correlation_s must be positive, got {self.correlation_s}")

    def sample(self, rng: np.random.Generator, shape: tuple[int, ...]) -> FloatArray:
        """Return a draw from the stationary distribution."""
        return self.std * rng.standard_normal(shape)

    def advance(self, value: FloatArray, *, dt_s: float, rng: np.random.Generator) -> FloatArray:
        """Return ``value`` after ``dt_s``; its distribution stays what ``sample`` draws from."""
        kept = math.exp(-dt_s / self.correlation_s)
        fresh = math.sqrt(1.0 - kept**2) * self.std
        return kept * value + fresh * rng.standard_normal(value.shape)


@dataclass(frozen=True, slots=True)
class VerticalLimits:
    """How fast an autopilot climbs and descends."""

    climb_max_mps: float = 3.0
    """PX4 MPC_Z_VEL_MAX_UP."""
    descent_max_mps: float = 1.5
    """PX4 MPC_Z_VEL_MAX_DN, ArduPilot WPNAV_SPEED_DN."""

    def __post_init__(self) -> None:
        if not (self.climb_max_mps > 0.0 and self.descent_max_mps > 0.0):
            raise ValueError(
                f"climb and descent must be positive, "
                f"got {self.climb_max_mps} and {self.descent_max_mps}"
            )

    def within(self, velocity_enu_mps: FloatArray) -> FloatArray:
        """Return velocities within the limits, ``(..., 3)``: shortened, not turned."""
        up_mps = velocity_enu_mps[..., 2:]
        excess = np.maximum(up_mps / self.climb_max_mps, -up_mps / self.descent_max_mps)
        return np.asarray(velocity_enu_mps / np.maximum(excess, 1.0))


def follow_velocity(
    velocity_mps: FloatArray,
    setpoint_mps: FloatArray,
    lag: VelocityLag,
    *,
    dt_s: float,
    time_constant_s: FloatArray | None = None,
    acceleration_max_mps2: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Follow a constant velocity setpoint for ``dt_s``.

    The error between setpoint and velocity keeps its direction. Its length shrinks at the
    acceleration limit while it is longer than ``limit * time_constant``, then exponentially.
    Both parts have closed forms, so the result does not depend on how ``dt_s`` is cut up.

    Args:
        velocity_mps: Shape ``(..., 3)``.
        setpoint_mps: Shape ``(..., 3)``.
        lag: The response.
        dt_s: Any duration, not negative.
        time_constant_s: Of each vehicle, ``(...)``, in place of the lag's.
        acceleration_max_mps2: Of each vehicle, ``(...)``, in place of the lag's.

    Returns:
        The velocity at the end and the displacement over ``dt_s``, shapes ``(..., 3)``.
    """
    slow_s = np.asarray(
        lag.time_constant_s if time_constant_s is None else time_constant_s[..., None]
    )
    most_mps2 = np.asarray(
        lag.acceleration_max_mps2
        if acceleration_max_mps2 is None
        else acceleration_max_mps2[..., None]
    )
    error_mps = setpoint_mps - velocity_mps
    length_mps = np.sqrt(np.einsum("...i,...i->...", error_mps, error_mps))[..., None]
    limited_s = np.clip(length_mps / most_mps2 - slow_s, 0.0, dt_s)
    decay_s = dt_s - limited_s

    knee_mps = length_mps - most_mps2 * limited_s
    left = np.exp(-decay_s / slow_s)
    # Integral of the error's length: a trapezium, then an exponential tail.
    area_m = 0.5 * (length_mps + knee_mps) * limited_s
    area_m = area_m + knee_mps * slow_s * (1.0 - left)

    direction = error_mps / np.where(length_mps > 0.0, length_mps, 1.0)
    return (
        setpoint_mps - direction * (knee_mps * left),
        setpoint_mps * dt_s - direction * area_m,
    )


def clip_to_box(position_enu_m: FloatArray, size_m: FloatArray) -> FloatArray:
    """Return the position with every axis held inside ``[0, size]``: walls are slid along.

    The paper says nothing of an action that leaves its cube (erratum E14).
    """
    return np.minimum(np.maximum(position_enu_m, 0.0), size_m)


def stop_at_walls(
    velocity_enu_mps: FloatArray, position_enu_m: FloatArray, size_m: FloatArray
) -> FloatArray:
    """Return the velocity without what points out of a box whose wall is touched."""
    outward = (position_enu_m <= 0.0) & (velocity_enu_mps < 0.0)
    outward |= (position_enu_m >= size_m) & (velocity_enu_mps > 0.0)
    return np.where(outward, 0.0, velocity_enu_mps)
