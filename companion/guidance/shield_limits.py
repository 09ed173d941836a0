"""What the shield keeps, and what it believes of the vehicle."""

import math
from dataclasses import dataclass

import numpy as np

from companion.arrays import FloatArray
from companion.guidance.drift import Drift


@dataclass(frozen=True, slots=True)
class ShieldLimits:
    """The numbers of one shield."""

    v_max_mps: float = 5.0
    margin_m: float = 2.0
    """From obstacles, and from the sides and the top of the box."""
    min_height_m: float = 2.0
    """Above the ground."""
    climb_max_mps: float = 3.0
    """PX4 MPC_Z_VEL_MAX_UP."""
    descent_max_mps: float = 1.5
    """PX4 MPC_Z_VEL_MAX_DN, ArduPilot WPNAV_SPEED_DN."""
    lag_s: float = 0.8
    """Time constant of the velocity loop; 0.58 s was measured on ArduCopter 4.6 and 0.76 s on PX4
    1.18. Too large is safe, too small is not."""
    brake_mps2: float = 1.6
    """Deceleration seen when the stream of setpoints ends: 1.5 to 1.7 on both. Too small is
    safe, too large is not."""
    period_s: float = 0.05
    """Of the control loop."""
    reaction_s: float = 0.1
    """From the setpoint on the wire to the first change of motion; two periods."""
    restore_s: float = 0.6
    """Inside the margin: time constant of the way out."""
    restore_max_mps: float = 3.0
    """Inside the margin: largest speed that the way out may demand."""

    def __post_init__(self) -> None:
        for name in self.__slots__:
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} must be positive and finite, got {value}")

    def slowed(self, velocity_mps: FloatArray) -> FloatArray:
        """Return a velocity within the speed limits, ``(3,)``: shortened, not turned."""
        east_mps, north_mps, up_mps = velocity_mps.tolist()
        # Scaled first: the length of a huge but finite vector is not finite.
        largest = max(abs(east_mps), abs(north_mps), abs(up_mps), 1.0)
        length = math.hypot(east_mps / largest, north_mps / largest, up_mps / largest)
        excess = max(
            length * (largest / self.v_max_mps),
            up_mps / self.climb_max_mps,
            -up_mps / self.descent_max_mps,
        )
        return velocity_mps if excess <= 1.0 else velocity_mps / excess

    def slowed_over_ground(self, velocity_mps: FloatArray, drift: Drift) -> FloatArray:
        """Return velocities over ground, ``(K, 3)``, whose commands keep the speed limits.

        A command is what is left without the drift; it is shortened, not turned.
        """
        velocity_mps = velocity_mps - drift.velocity_enu_mps
        excess = np.sqrt(np.einsum("ki,ki->k", velocity_mps, velocity_mps)) / self.v_max_mps
        up_mps = velocity_mps[:, 2]
        excess = np.maximum(excess, up_mps / self.climb_max_mps)
        excess = np.maximum(excess, up_mps / -self.descent_max_mps)
        velocity_mps = velocity_mps / np.maximum(excess, 1.0)[:, None]
        return np.asarray(velocity_mps + drift.velocity_enu_mps)
