"""The trajectory of PX4's automatic modes: no velocity without limits of acceleration and jerk."""

import math
from dataclasses import dataclass

from sim.mock.dynamics import ZERO, Vector

STANDING_MPS = 0.05


@dataclass(slots=True)
class Trajectory:
    """A horizontal way that the vehicle follows, smooth whatever is wished for."""

    position_m: Vector = ZERO
    velocity_mps: Vector = ZERO
    _acceleration_mps2: Vector = ZERO

    def start(self, position_m: Vector, velocity_mps: Vector) -> None:
        """Begin at the vehicle's own place and velocity, with no acceleration."""
        self.position_m, self.velocity_mps, self._acceleration_mps2 = position_m, velocity_mps, ZERO

    @property
    def stands(self) -> bool:
        """Whether it has come to rest."""
        return math.hypot(self.velocity_mps[0], self.velocity_mps[1]) < STANDING_MPS

    def follow(
        self, wanted_mps: Vector, dt_s: float, *, acceleration_mps2: float, jerk_mps3: float
    ) -> None:
        """Step towards a horizontal velocity.

        Args:
            wanted_mps: The velocity to reach.
            dt_s: Duration of the step.
            acceleration_mps2: Largest acceleration, MPC_ACC_HOR.
            jerk_mps3: Largest change of it per second, MPC_JERK_AUTO.
        """
        vn, ve, _ = self.velocity_mps
        an, ae, _ = self._acceleration_mps2
        north, east = wanted_mps[0] - vn, wanted_mps[1] - ve
        missing = math.hypot(north, east)
        # So much acceleration can be taken back by the jerk until nothing is missing any more.
        most = min(acceleration_mps2, math.sqrt(2.0 * jerk_mps3 * missing), missing / dt_s)
        share = most / missing if missing > 0.0 else 0.0
        jn, je = north * share - an, east * share - ae
        change = math.hypot(jn, je)
        part = min(1.0, jerk_mps3 * dt_s / change) if change > 0.0 else 0.0
        an, ae = an + jn * part, ae + je * part
        vn, ve = vn + an * dt_s, ve + ae * dt_s
        self._acceleration_mps2 = (an, ae, 0.0)
        self.velocity_mps = (vn, ve, 0.0)
        north, east, down = self.position_m
        self.position_m = (north + vn * dt_s, east + ve * dt_s, down)
