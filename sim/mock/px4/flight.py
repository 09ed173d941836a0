"""What each mode makes the vehicle do: demands for the point mass, once per step."""

import math
from dataclasses import dataclass, field

from sim.mock.dynamics import ZERO, PointMass, Vector, wrap_pi
from sim.mock.estimator import Estimator, subtract
from sim.mock.parameters import Parameters
from sim.mock.pilot import Sticks
from sim.mock.px4.modes import Mode
from sim.mock.px4.sticks import StickMotion, deflection
from sim.mock.px4.trajectory import Trajectory
from sim.mock.setpoints import Setpoint

APPROACH_MPS2 = 1.5
"""Deceleration planned for when nearing a point; recorded stops are of this order."""
ERROR_MAX_M = 2.0
"""MPC_XY_ERR_MAX."""
AUTO_CLIMB_GAIN_PER_S = 0.65
"""How automatic modes near a height (recorded)."""
CLIMB_GLIDE_S = 0.5
NEAR_HOME_M = 6.0
"""RTL climbs at least so high above home, however near that is (recorded)."""
REACHED_M = 0.5
YAW_GAIN_PER_S = 2.8
"""MC_YAW_P."""
YAW_RATE_MAX_RADPS = 1.0
STICK_TURN_RADPS = 1.5
LAND_SLOW_FROM_M, LAND_SLOW_TO_M = 10.0, 5.0
"""MPC_LAND_ALT1 and MPC_LAND_ALT2: between them sinking slows down to MPC_LAND_SPEED."""


@dataclass(slots=True)
class Demand:
    """What the controller is asked for in this step; all in true NED."""

    velocity_mps: Vector = ZERO
    feedforward_mps2: Vector = ZERO
    position_m: Vector | None = None
    yaw_rate_radps: float = 0.0


@dataclass(slots=True)
class Flight:
    """The flight tasks of all modes, and the points they remember."""

    body: PointMass
    estimator: Estimator
    parameters: Parameters
    demand: Demand = field(default_factory=Demand)
    takeoff_altitude_m: float = math.nan
    """AMSL; NaN means MIS_TAKEOFF_ALT above home."""
    hold_true_m: Vector = ZERO
    home_true_m: Vector = ZERO
    takeoff_done: bool = False
    landing: bool = False
    """Whether it sinks in order to land."""
    blind: bool = False
    """Whether the position is lost: landing then only sinks."""
    _mode: Mode = Mode.LOITER
    _return_down_m: float = 0.0
    _homing: bool = False
    _braking: bool = False
    _trajectory: Trajectory = field(default_factory=Trajectory)
    _stick_motion: StickMotion = field(default_factory=StickMotion)
    _texts: list[str] = field(default_factory=list)

    def take_texts(self) -> list[str]:
        """Return what the navigator said since the last call."""
        texts, self._texts = self._texts, []
        return texts

    def enter(self, mode: Mode, home_true_m: Vector | None) -> None:
        """Begin ``mode`` where the vehicle is."""
        self._mode = mode
        self.home_true_m = home_true_m or ZERO
        self.takeoff_done = self.landing = self._homing = False
        self._trajectory.start(self.body.position_m, self.body.velocity_mps)
        # Not with the vehicle's own motion: PX4 goes on from the last setpoint.
        self._stick_motion.start(self.demand.velocity_mps, self.demand.feedforward_mps2)
        self._braking = True
        north, east, down = self.body.position_m
        self.hold_true_m = (north, east, down + CLIMB_GLIDE_S * self.body.velocity_mps[2])
        if mode is Mode.TAKEOFF:
            self.hold_true_m = (north, east, self._takeoff_down_m(down))
        elif mode is Mode.LAND:
            self.landing = True
        elif mode is Mode.RTL:
            far = self._home_distance_m() > self.parameters.number("RTL_MIN_DIST")
            height = self.parameters.number("RTL_RETURN_ALT")
            least_m = height if far else NEAR_HOME_M
            self._return_down_m = min(down, self.home_true_m[2] - least_m)
            above = self.home_true_m[2] - self._return_down_m
            amsl = self.estimator.altitude_m((0.0, 0.0, self._return_down_m))
            self._texts.append(
                f"RTL: start return at {math.ceil(amsl)} m ({math.ceil(above)} m above destination)"
            )

    def go_to(self, point_m: Vector) -> None:
        """Fly to a true point and hold there, without stopping first."""
        self.hold_true_m = point_m
        self._braking = False

    def shift(self, step_m: Vector) -> None:
        """Move the points it flies to, which now mean other true ones."""
        self.hold_true_m = subtract(self.hold_true_m, step_m)
        self._trajectory.position_m = subtract(self._trajectory.position_m, step_m)

    def step(
        self,
        dt_s: float,
        *,
        flying: bool,
        setpoint: Setpoint | None,
        sticks: Sticks,
        drift_mps: Vector,
    ) -> tuple[bool, bool]:
        """Move the body for ``dt_s``.

        Args:
            dt_s: Duration.
            flying: Whether the motors carry the vehicle; else it stands with idling motors.
            setpoint: The newest setpoint in OFFBOARD.
            sticks: The pilot's sticks, for the manual modes.
            drift_mps: Drift by wind.

        Returns:
            Whether the mode wants to leave the ground, and whether it wants to sink.
        """
        demand = self._demand(setpoint, sticks)
        if self._mode.is_auto:
            demand.velocity_mps = self._smoothed(demand.velocity_mps, dt_s)
        elif self._mode.needs_pilot:
            self._steer(demand, sticks, dt_s)
        self.demand = demand
        # PX4 takes off for any climb rate, or any position above the present one.
        up = demand.velocity_mps[2] < -0.05 or demand.feedforward_mps2[2] < 0.0
        wants_up = up and self._mode is not Mode.LOITER
        if flying:
            self.body.fly(
                demand.velocity_mps,
                dt_s,
                feedforward_mps2=demand.feedforward_mps2,
                drift_mps=drift_mps,
            )
            self.body.turn(demand.yaw_rate_radps, dt_s)
        else:
            self.body.rest()
        return wants_up, demand.velocity_mps[2] > 0.1

    def _demand(self, setpoint: Setpoint | None, sticks: Sticks) -> Demand:
        if self._mode is Mode.OFFBOARD:
            return self._offboard(setpoint)
        if self._mode.needs_pilot:
            return self._manual(sticks)
        if self._mode is Mode.RTL:
            self._advance_return()
        if self.landing:
            return Demand(self._land_velocity(), position_m=self.hold_true_m)
        if self._mode is Mode.TAKEOFF:
            self.takeoff_done = self.body.position_m[2] - self.hold_true_m[2] < REACHED_M
        return Demand(self._velocity_to(self.hold_true_m), position_m=self.hold_true_m)

    def _offboard(self, setpoint: Setpoint | None) -> Demand:
        if setpoint is None or not setpoint.complete:
            return Demand()
        rate = setpoint.yaw_rate_radps if math.isfinite(setpoint.yaw_rate_radps) else 0.0
        if math.isfinite(setpoint.yaw_rad):
            rate += YAW_GAIN_PER_S * wrap_pi(setpoint.yaw_rad - self.body.yaw_rad)
        rate = max(-YAW_RATE_MAX_RADPS, min(YAW_RATE_MAX_RADPS, rate))
        if setpoint.only_velocity:
            return Demand(self._limited(setpoint.velocity_mps), yaw_rate_radps=rate)
        local = self.estimator.to_local(self.body.position_m)
        velocity, feedforward = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
        for axis in range(3):
            position, speed = setpoint.position_m[axis], setpoint.velocity_mps[axis]
            push = setpoint.acceleration_mps2[axis]
            if math.isfinite(position):  # position leads, velocity is its feed-forward (P9)
                gain = self.parameters.number("MPC_Z_P" if axis == 2 else "MPC_XY_P")
                velocity[axis] = gain * (position - local[axis])
            elif not math.isfinite(speed):
                velocity[axis] = self.body.velocity_mps[axis]
            velocity[axis] += speed if math.isfinite(speed) else 0.0
            feedforward[axis] = push if math.isfinite(push) else 0.0
        if all(math.isfinite(value) for value in setpoint.position_m[:2]):
            away = [setpoint.position_m[axis] - local[axis] for axis in range(2)]
            brakable = math.sqrt(2.0 * APPROACH_MPS2 * math.hypot(*away))
            share = min(1.0, brakable / max(math.hypot(*velocity[:2]), 1e-9))
            velocity[:2] = velocity[0] * share, velocity[1] * share
        return Demand(
            self._limited((velocity[0], velocity[1], velocity[2])),
            (feedforward[0], feedforward[1], feedforward[2]),
            yaw_rate_radps=rate,
        )

    def _manual(self, sticks: Sticks) -> Demand:
        climb = self.parameters.number("MPC_Z_VEL_MAX_UP") if sticks.up > 0.0 else 1.5
        velocity = self._limited((0.0, 0.0, -climb * sticks.up))
        return Demand(velocity, yaw_rate_radps=STICK_TURN_RADPS * sticks.turn)

    def _advance_return(self) -> None:
        if self.landing:
            return
        down = self.body.position_m[2]
        if not self._homing:
            self.hold_true_m = (*self.hold_true_m[:2], self._return_down_m)
            self._homing = abs(down - self._return_down_m) < REACHED_M
        else:
            self.hold_true_m = (self.home_true_m[0], self.home_true_m[1], self._return_down_m)
            if self._home_distance_m() < self.parameters.number("RTL_MIN_DIST"):
                self.landing = True
                self._texts.append("RTL: land at destination")

    def _land_velocity(self) -> Vector:
        north, east, _ = ZERO if self.blind else self._velocity_to(self.hold_true_m)
        fast, slow = (
            self.parameters.number("MPC_Z_VEL_MAX_DN"),
            self.parameters.number("MPC_LAND_SPEED"),
        )
        height = self.home_true_m[2] - self.body.position_m[2]
        share = (height - LAND_SLOW_TO_M) / (LAND_SLOW_FROM_M - LAND_SLOW_TO_M)
        return north, east, slow + (fast - slow) * max(0.0, min(1.0, share))

    def _velocity_to(self, point_m: Vector) -> Vector:
        north, east, _ = subtract(point_m, self._trajectory.position_m)
        down = point_m[2] - self.body.position_m[2]
        distance = math.hypot(north, east)
        speed = min(
            self.parameters.number("MPC_XY_P") * distance,
            math.sqrt(2.0 * APPROACH_MPS2 * distance),
            self.parameters.number("MPC_XY_CRUISE"),
        )
        share = speed / distance if distance > 0.0 else 0.0
        return self._limited((north * share, east * share, AUTO_CLIMB_GAIN_PER_S * down))

    def _limited(self, velocity_mps: Vector) -> Vector:
        north, east, down = velocity_mps
        fastest = self.parameters.number("MPC_XY_VEL_MAX")
        share = min(1.0, fastest / max(math.hypot(north, east), 1e-9))
        up = self.parameters.number("MPC_Z_VEL_MAX_UP")
        sink = self.parameters.number("MPC_Z_VEL_MAX_DN")
        return north * share, east * share, max(-up, min(sink, down))

    def _takeoff_down_m(self, down_m: float) -> float:
        lowest = self.home_true_m[2] - self.parameters.number("MIS_TAKEOFF_ALT")
        if not math.isfinite(self.takeoff_altitude_m):
            return min(down_m, lowest)
        ground_amsl_m = self.estimator.altitude_m(ZERO)
        wanted = ground_amsl_m - self.takeoff_altitude_m
        if wanted > lowest:
            self._texts.append("Using minimum takeoff altitude")
        if min(wanted, lowest) > down_m:
            self._texts.append("Already higher than takeoff altitude")
        return min(wanted, lowest, down_m)

    def _smoothed(self, wanted_mps: Vector, dt_s: float) -> Vector:
        """Follow the trajectory of the automatic modes, which begins by braking.

        What it holds on to is where the trajectory has come to rest.
        """
        if self.blind:
            return wanted_mps
        trajectory = self._trajectory
        behind_north, behind_east, _ = subtract(trajectory.position_m, self.body.position_m)
        # The trajectory waits for a vehicle that lags behind.
        stretch = 1.0 - min(1.0, math.hypot(behind_north, behind_east) / ERROR_MAX_M)
        trajectory.follow(
            ZERO if self._braking else wanted_mps,
            max(1e-4, stretch * dt_s),
            acceleration_mps2=self.parameters.number("MPC_ACC_HOR"),
            jerk_mps3=self.parameters.number("MPC_JERK_AUTO"),
        )
        if self._braking and trajectory.stands:
            self._braking = False
            if not self._homing:
                north, east, _ = trajectory.position_m
                self.hold_true_m = (north, east, self.hold_true_m[2])
        gain = self.parameters.number("MPC_XY_P")
        return self._limited(
            (
                trajectory.velocity_mps[0] + gain * behind_north,
                trajectory.velocity_mps[1] + gain * behind_east,
                wanted_mps[2],
            )
        )

    def _steer(self, demand: Demand, sticks: Sticks, dt_s: float) -> None:
        """Follow the sticks over the ground, and keep the place once they ask for nothing."""
        cos, sin = math.cos(self.body.yaw_rad), math.sin(self.body.yaw_rad)
        forward, right = deflection(sticks.forward), deflection(sticks.right)
        motion = self._stick_motion
        motion.follow(
            forward * cos - right * sin,
            forward * sin + right * cos,
            dt_s,
            speed_mps=self.parameters.number("MPC_VEL_MANUAL"),
            acceleration_mps2=self.parameters.number("MPC_ACC_HOR"),
        )
        north, east = motion.north_mps, motion.east_mps
        if not motion.stands:
            self.hold_true_m = self.body.position_m
        elif self._mode is Mode.POSCTL:
            gain = self.parameters.number("MPC_XY_P")
            away_north, away_east, _ = subtract(self.hold_true_m, self.body.position_m)
            north, east = gain * away_north, gain * away_east
        demand.velocity_mps = self._limited((north, east, demand.velocity_mps[2]))
        demand.feedforward_mps2 = motion.acceleration_mps2

    def _home_distance_m(self) -> float:
        north, east, _ = subtract(self.home_true_m, self.body.position_m)
        return math.hypot(north, east)
