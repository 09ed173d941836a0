"""A point mass that answers velocity demands as the autopilots' controllers do.

Plain floats instead of arrays: there is one vehicle, stepped a hundred times a second, and
three-element numpy arrays would cost ten times as much.
"""

import math
from dataclasses import dataclass, field

import numpy as np

Vector = tuple[float, float, float]
"""North, east, down."""

ZERO: Vector = (0.0, 0.0, 0.0)
GRAVITY_MPS2 = 9.80665


@dataclass(frozen=True, slots=True)
class Response:
    """How fast the vehicle follows a velocity; every personality has its own fit.

    A velocity controller with an integral works against drag: the vehicle soon has a share of
    what was asked for, and the rest only when the integral has found out about the drag.
    """

    velocity_lag_s: float = 0.5
    """One over the gain of the horizontal velocity controller."""
    climb_lag_s: float = 0.5
    attitude_lag_s: float = 0.15
    """Time the airframe needs to tilt; gives the step its soft start."""
    thrust_lag_s: float = 0.15
    drag_per_s: float = 0.0
    """Deceleration by drag per speed."""
    integral_per_s2: float = 0.0
    climb_integral_per_s2: float = 0.0
    acceleration_xy_mps2: float = 3.0
    acceleration_up_mps2: float = 2.0
    acceleration_down_mps2: float = 3.0
    shortfall: float = 0.0
    """Steady share of a horizontal velocity that is never reached, whatever the integral does."""


@dataclass(slots=True)
class Wind:
    """Mean wind plus gusts (first-order Gauss-Markov, seeded)."""

    rng: np.random.Generator
    mean_ned_mps: Vector = ZERO
    gust_mps: float = 0.0
    """Standard deviation of the gusts, per axis."""
    coupling: float = 0.1
    """Share of the wind that the controller lets through as drift."""
    correlation_s: float = 2.0
    _gust: Vector = ZERO

    def drift_ned_mps(self, dt_s: float) -> Vector:
        """Advance the gusts by ``dt_s`` and return the drift they and the mean wind cause."""
        if self.gust_mps > 0.0:
            decay = math.exp(-dt_s / self.correlation_s)
            kick = self.gust_mps * math.sqrt(1.0 - decay * decay)
            n, e, d = (float(value) for value in self.rng.standard_normal(3))
            gn, ge, gd = self._gust
            self._gust = (
                decay * gn + kick * n,
                decay * ge + kick * e,
                decay * gd + 0.3 * kick * d,
            )
        mean, gust = self.mean_ned_mps, self._gust
        return (
            self.coupling * (mean[0] + gust[0]),
            self.coupling * (mean[1] + gust[1]),
            self.coupling * (mean[2] + gust[2]),
        )


@dataclass(slots=True)
class PointMass:
    """Position, velocity and attitude of the vehicle, in true local NED; down 0 is the ground."""

    response: Response = field(default_factory=Response)
    position_m: Vector = ZERO
    velocity_mps: Vector = ZERO
    acceleration_mps2: Vector = ZERO
    yaw_rad: float = 0.0
    yaw_rate_radps: float = 0.0
    trim_mps2: Vector = ZERO
    """What the integral of the velocity controller adds."""

    @property
    def on_ground(self) -> bool:
        """Whether the vehicle touches the ground."""
        return self.position_m[2] >= 0.0

    @property
    def attitude_rad(self) -> tuple[float, float, float]:
        """Roll, pitch and yaw: the tilt is what makes the present acceleration."""
        north, east, _ = self.acceleration_mps2
        cos, sin = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        right, forward = -north * sin + east * cos, north * cos + east * sin
        roll, pitch = math.atan2(right, GRAVITY_MPS2), -math.atan2(forward, GRAVITY_MPS2)
        return roll, pitch, self.yaw_rad

    def rest(self) -> None:
        """Stand still where it is: motors idle or off, on the ground."""
        self.velocity_mps = self.acceleration_mps2 = self.trim_mps2 = ZERO
        self.yaw_rate_radps = 0.0
        self.position_m = (self.position_m[0], self.position_m[1], min(0.0, self.position_m[2]))

    def fall(self, dt_s: float) -> None:
        """Drop for ``dt_s`` with the motors off."""
        vn, ve, vd = self.velocity_mps
        self.velocity_mps = (vn, ve, vd + GRAVITY_MPS2 * dt_s)
        self._move(dt_s)

    def fly(
        self,
        velocity_mps: Vector,
        dt_s: float,
        *,
        feedforward_mps2: Vector = ZERO,
        drift_mps: Vector,
    ) -> None:
        """Follow a velocity demand for ``dt_s``.

        Args:
            velocity_mps: Demanded velocity.
            dt_s: Duration of the step; small against the lags.
            feedforward_mps2: Acceleration demanded on top.
            drift_mps: Drift by wind, added to where the velocity settles.
        """
        response = self.response
        reach = 1.0 - response.shortfall
        vn, ve, vd = self.velocity_mps
        tn, te, td = self.trim_mps2
        north_error = reach * velocity_mps[0] + drift_mps[0] - vn
        east_error = reach * velocity_mps[1] + drift_mps[1] - ve
        down_error = velocity_mps[2] + drift_mps[2] - vd
        drag = response.drag_per_s
        north = north_error / response.velocity_lag_s + tn - drag * vn + feedforward_mps2[0]
        east = east_error / response.velocity_lag_s + te - drag * ve + feedforward_mps2[1]
        down = down_error / response.climb_lag_s + td - drag * vd + feedforward_mps2[2]
        horizontal = math.hypot(north, east)
        if horizontal > response.acceleration_xy_mps2:
            north *= response.acceleration_xy_mps2 / horizontal
            east *= response.acceleration_xy_mps2 / horizontal
        else:  # at the limit it does not wind up
            tn += response.integral_per_s2 * north_error * dt_s
            te += response.integral_per_s2 * east_error * dt_s
        if -response.acceleration_up_mps2 < down < response.acceleration_down_mps2:
            td += response.climb_integral_per_s2 * down_error * dt_s
        down = min(response.acceleration_down_mps2, max(-response.acceleration_up_mps2, down))
        self.trim_mps2 = (tn, te, td)
        tilt = 1.0 - math.exp(-dt_s / response.attitude_lag_s)
        push = 1.0 - math.exp(-dt_s / response.thrust_lag_s)
        an, ae, ad = self.acceleration_mps2
        an, ae, ad = an + (north - an) * tilt, ae + (east - ae) * tilt, ad + (down - ad) * push
        self.acceleration_mps2 = (an, ae, ad)
        self.velocity_mps = (vn + an * dt_s, ve + ae * dt_s, vd + ad * dt_s)
        self._move(dt_s)

    def turn(self, rate_radps: float, dt_s: float) -> None:
        """Turn at ``rate_radps``, clockwise seen from above, for ``dt_s``."""
        self.yaw_rate_radps = rate_radps
        self.yaw_rad = wrap_pi(self.yaw_rad + rate_radps * dt_s)

    def _move(self, dt_s: float) -> None:
        north, east, down = self.position_m
        vn, ve, vd = self.velocity_mps
        self.position_m = (north + vn * dt_s, east + ve * dt_s, down + vd * dt_s)
        if self.position_m[2] >= 0.0 and vd >= 0.0:
            # Skids are on the ground: no sinking, and friction takes the rest.
            self.position_m = (self.position_m[0], self.position_m[1], 0.0)
            self.velocity_mps = self.acceleration_mps2 = self.trim_mps2 = ZERO


def wrap_pi(angle_rad: float) -> float:
    """Return ``angle_rad`` in ``[-pi, pi)``."""
    return (angle_rad + math.pi) % (2.0 * math.pi) - math.pi
