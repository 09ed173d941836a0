"""What sticks mean in PX4's Position mode (MPC_POS_MODE 4): a push against a drag.

A stick is an acceleration; a drag in proportion to the velocity makes its full deflection end at
MPC_VEL_MANUAL, and grows when the stick is let go, which brakes. So 0.9 of a stick is at 63 % of
its speed after 1.7 s only.
"""

import math
from dataclasses import dataclass

from sim.mock.dynamics import Vector

EXPO, DEAD_ZONE = 0.6, 0.1
"""MPC_XY_MAN_EXPO and MPC_HOLD_DZ."""
JERK_MPS3 = 8.0
"""MPC_JERK_MAX."""
BOOST_S = 0.8
"""Time constant with which the brake takes hold and lets go."""
LEAST_BOOST = 2.0
BOOST_BLENDS_FROM = 1.0
"""From no boost to ``LEAST_BOOST`` the drag turns from linear to one that stops the vehicle."""


@dataclass(slots=True)
class StickMotion:
    """The velocity that the sticks ask for; north and east."""

    north_mps: float = 0.0
    east_mps: float = 0.0
    _push_mps2: tuple[float, float] = (0.0, 0.0)
    _boost: float = BOOST_BLENDS_FROM

    def start(self, velocity_mps: Vector, acceleration_mps2: Vector) -> None:
        """Begin with a motion."""
        self.north_mps, self.east_mps, _ = velocity_mps
        self._push_mps2 = (acceleration_mps2[0], acceleration_mps2[1])
        self._boost = BOOST_BLENDS_FROM

    @property
    def acceleration_mps2(self) -> Vector:
        """The acceleration that goes with the velocity."""
        return (*self._push_mps2, 0.0)

    @property
    def stands(self) -> bool:
        """Whether nothing is asked for: the vehicle keeps its place."""
        return self.north_mps == self.east_mps == 0.0

    def follow(
        self, north: float, east: float, dt_s: float, *, speed_mps: float, acceleration_mps2: float
    ) -> None:
        """Step by ``dt_s``.

        Args:
            north: Deflection of the sticks to the north, -1 to 1.
            east: And to the east.
            dt_s: Duration of the step.
            speed_mps: What full deflection ends at, MPC_VEL_MANUAL.
            acceleration_mps2: Mean acceleration towards it, MPC_ACC_HOR.
        """
        released = north == east == 0.0
        boost = max(LEAST_BOOST, math.sqrt(speed_mps)) if released else BOOST_BLENDS_FROM
        self._boost += (boost - self._boost) * dt_s / (BOOST_S + dt_s)
        full_mps2 = 2.0 * acceleration_mps2  # the drag takes half of it on average
        speed = math.hypot(self.north_mps, self.east_mps)
        share = (self._boost - BOOST_BLENDS_FROM) / (LEAST_BOOST - BOOST_BLENDS_FROM)
        share = max(0.0, min(1.0, share))
        felt_mps = share * (math.sqrt(speed) if speed < 1.0 else speed) + (1.0 - share) * speed
        drag_mps2 = full_mps2 / speed_mps * self._boost * felt_mps
        if released and speed <= drag_mps2 * dt_s:
            self.north_mps = self.east_mps = drag_mps2 = speed = 0.0
        along = drag_mps2 / speed if speed > 0.0 else 0.0
        wanted = (
            full_mps2 * north - along * self.north_mps,
            full_mps2 * east - along * self.east_mps,
        )
        self._push_mps2 = _slewed(self._push_mps2, wanted, JERK_MPS3 * dt_s)
        if released and speed == 0.0:
            return
        self.north_mps += self._push_mps2[0] * dt_s
        self.east_mps += self._push_mps2[1] * dt_s


def deflection(stick: float) -> float:
    """Return what is left of a stick's deflection after dead zone and exponential curve."""
    if abs(stick) <= DEAD_ZONE:
        return 0.0
    moved = (stick - math.copysign(DEAD_ZONE, stick)) / (1.0 - DEAD_ZONE)
    return (1.0 - EXPO) * moved + EXPO * moved**3


def _slewed(
    now: tuple[float, float], wanted: tuple[float, float], most: float
) -> tuple[float, float]:
    north, east = wanted[0] - now[0], wanted[1] - now[1]
    change = math.hypot(north, east)
    part = min(1.0, most / change) if change > 0.0 else 0.0
    return now[0] + north * part, now[1] + east * part
