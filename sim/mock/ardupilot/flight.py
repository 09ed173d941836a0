"""What each of ArduCopter's modes makes the vehicle do: demands for the point mass."""

import math
from dataclasses import dataclass
from enum import Enum, auto

from sim.mock.ardupilot.controllers import avoid_fence, heading_rate, toward
from sim.mock.ardupilot.modes import Mode
from sim.mock.dynamics import ZERO, PointMass, Vector
from sim.mock.estimator import Estimator, add, subtract
from sim.mock.parameters import Parameters
from sim.mock.pilot import Sticks
from sim.mock.setpoints import Setpoint

BRAKE_S = 1.4
"""BRAKE lets the speed decay with this time constant (recorded: 2.75 m from 2 m/s)."""
STOP_S = 1.0
"""RTL climbs where the vehicle can stop: 1/PSC_POSXY_P ahead of it."""
LAND_PAUSE_S = 4.0
"""A failsafe's LAND does not sink for so long (LAND_WITH_DELAY_MS)."""
COAST_MPS = 0.3
"""How fast it drifts on without a position (recorded)."""
LAND_GAIN_PER_S = 1.0
SLOW_MPS = 0.15
"""Below this speed a stopped vehicle begins to hold its place."""
REACHED_M = 0.3
TAKEN_OFF_MPS = 0.25
STICK_SPEED_MPS = 5.0
STICK_TURN_RADPS = 2.0
CM = 0.01
"""ArduPilot's parameters count in centimetres."""


class Guided(Enum):
    """What GUIDED is doing."""

    VELOCITY = auto()
    POSITION = auto()
    TAKEOFF = auto()


class Return(Enum):
    """The stages of RTL."""

    CLIMB = auto()
    FLY = auto()
    WAIT = auto()
    LAND = auto()


@dataclass(slots=True)
class Demand:
    """What the controller is asked for in this step; all in true NED."""

    velocity_mps: Vector = ZERO
    yaw_rate_radps: float = 0.0


@dataclass(slots=True)
class Flight:
    """The points and stages that the modes remember."""

    body: PointMass
    estimator: Estimator
    parameters: Parameters
    guided: Guided = Guided.VELOCITY
    home_true_m: Vector = ZERO
    hold_true_m: Vector | None = None
    """Where it holds; ``None`` while it still stops."""
    velocity_mps: Vector = ZERO
    """What GUIDED steers by, after the time-out."""
    blind: bool = False
    """Whether LAND goes without a position."""
    sinks_from_s: float = 0.0
    """LAND waits until then: a failsafe gives the pilot time to think."""
    _coasting_mps: Vector = ZERO
    target_true_m: Vector = ZERO
    """Where RTL and position targets lead."""
    _stage: Return = Return.CLIMB
    _stage_since_s: float = 0.0

    @property
    def landing(self) -> bool:
        """Whether RTL has reached its last stage."""
        return self._stage is Return.LAND

    def enter(self, mode: Mode, now_s: float) -> None:
        """Begin ``mode`` where the vehicle is."""
        self.hold_true_m = None
        self.blind = False
        self.sinks_from_s = now_s
        self._stage, self._stage_since_s = Return.CLIMB, now_s
        if mode is Mode.GUIDED:
            self.stop()
        elif mode is Mode.BRAKE:
            vn, ve, vd = self.body.velocity_mps
            self.hold_true_m = add(self.body.position_m, (vn * BRAKE_S, ve * BRAKE_S, vd))
        elif mode is Mode.RTL:
            vn, ve, _ = self.body.velocity_mps
            north, east, down = add(self.body.position_m, (vn * STOP_S, ve * STOP_S, 0.0))
            height_m = self._return_height_m(north, east)
            self.target_true_m = (north, east, min(down, self.home_true_m[2] - height_m))

    def land_after_failsafe(self, now_s: float, *, blind: bool) -> None:
        """Begin LAND because of a failsafe: with a pause, and without a position it coasts."""
        self.sinks_from_s = now_s + LAND_PAUSE_S
        self.blind = blind
        north, east, _ = self.body.velocity_mps
        share = min(1.0, COAST_MPS / max(math.hypot(north, east), 1e-9))
        self._coasting_mps = (north * share, east * share, 0.0)

    def stop(self) -> None:
        """Fly at zero velocity in GUIDED: on entering, and when a setpoint makes no sense."""
        self.guided, self.velocity_mps = Guided.VELOCITY, ZERO

    def take_off(self, altitude_m: float) -> None:
        """Climb to ``altitude_m`` above home in GUIDED."""
        north, east, _ = self.body.position_m
        self.guided = Guided.TAKEOFF
        self.hold_true_m = (north, east, self.home_true_m[2] - altitude_m)

    def demand(self, mode: Mode, now_s: float, setpoint: Setpoint | None, sticks: Sticks) -> Demand:
        """Return what ``mode`` asks for; ``setpoint`` is the one that GUIDED follows."""
        if mode is Mode.GUIDED:
            return self._guided(setpoint, sticks)
        if mode is Mode.LAND:
            north, east, down = self._land()
            if self.blind:
                north, east, _ = self._coasting_mps
            sinks = now_s >= self.sinks_from_s
            return Demand((north, east, down if sinks else 0.0), STICK_TURN_RADPS * sticks.turn)
        if mode is Mode.RTL:
            return Demand(self._return(now_s))
        if mode is Mode.BRAKE and self.hold_true_m is not None:
            away = subtract(self.hold_true_m, self.body.position_m)
            north, east, down = (value / BRAKE_S for value in away)
            return Demand((north, east, down))
        return Demand(self._manual(sticks), STICK_TURN_RADPS * sticks.turn)

    def taken_off(self) -> bool:
        """Return whether a take-off has reached its altitude."""
        if self.hold_true_m is None:
            return False
        left_m = self.body.position_m[2] - self.hold_true_m[2]
        return left_m < REACHED_M and abs(self.body.velocity_mps[2]) < TAKEN_OFF_MPS

    def _guided(self, setpoint: Setpoint | None, sticks: Sticks) -> Demand:
        turn = STICK_TURN_RADPS * sticks.turn
        if int(self.parameters.number("GUID_OPTIONS")) & 4:
            turn = 0.0
        if self.guided is Guided.TAKEOFF and self.hold_true_m is not None:
            return Demand(self._to(self.hold_true_m), turn)
        if self.guided is Guided.POSITION and setpoint is not None:
            velocity = add(self._to(self.target_true_m), self.velocity_mps)
        elif self.velocity_mps == ZERO:
            return Demand(self._stay(), turn or self._yaw_rate(setpoint))
        else:
            velocity = avoid_fence(
                self.velocity_mps, self.body.position_m, self.home_true_m, self.parameters
            )
        return Demand(self._clipped(velocity), turn or self._yaw_rate(setpoint))

    def _yaw_rate(self, setpoint: Setpoint | None) -> float:
        slew_radps = math.radians(self.parameters.number("ATC_SLEW_YAW") * CM)
        return heading_rate(self.body, setpoint, slew_radps)

    def _stay(self) -> Vector:
        """Stop, then hold the place where it has stopped."""
        if self.hold_true_m is None:
            if math.hypot(*self.body.velocity_mps) > SLOW_MPS:
                return ZERO
            self.hold_true_m = self.body.position_m
        return self._to(self.hold_true_m)

    def _manual(self, sticks: Sticks) -> Vector:
        if sticks.centred:
            return self._stay()
        self.hold_true_m = None
        cos, sin = math.cos(self.body.yaw_rad), math.sin(self.body.yaw_rad)
        climb_mps = self.parameters.number("PILOT_SPEED_UP") * CM
        return (
            STICK_SPEED_MPS * (sticks.forward * cos - sticks.right * sin),
            STICK_SPEED_MPS * (sticks.forward * sin + sticks.right * cos),
            -climb_mps * sticks.up,
        )

    def _land(self) -> Vector:
        down = self.body.position_m[2]
        if self.hold_true_m is None and math.hypot(*self.body.velocity_mps[:2]) < SLOW_MPS:
            self.hold_true_m = self.body.position_m
        stay = ZERO
        if self.hold_true_m is not None and not self.blind:
            stay = self._to((self.hold_true_m[0], self.hold_true_m[1], down))
        slow, low = self._metres("LAND_SPEED"), self._metres("LAND_ALT_LOW")
        fast = self._metres("LAND_SPEED_HIGH") or self._metres("WPNAV_SPEED_DN")
        above_m = max(0.0, self.home_true_m[2] - down - low)
        sink = min(
            LAND_GAIN_PER_S * above_m, math.sqrt(2.0 * self._metres("WPNAV_ACCEL_Z") * above_m)
        )
        return stay[0], stay[1], max(slow, min(fast, sink))

    def _return(self, now_s: float) -> Vector:
        if self._stage is Return.LAND:
            return self._land()
        left = subtract(self.target_true_m, self.body.position_m)
        if self._stage is Return.CLIMB and abs(left[2]) < REACHED_M:
            self._go_on(Return.FLY, now_s)
            self.target_true_m = (*self.home_true_m[:2], self.target_true_m[2])
        elif self._stage is Return.FLY and math.hypot(*left) < REACHED_M:
            self._go_on(Return.WAIT, now_s)
        waited_s = now_s - self._stage_since_s
        if self._stage is Return.WAIT and waited_s >= self.parameters.number("RTL_LOIT_TIME") / 1e3:
            self._go_on(Return.LAND, now_s)
            self.hold_true_m = self.target_true_m
        return self._to(self.target_true_m)

    def _go_on(self, stage: Return, now_s: float) -> None:
        self._stage, self._stage_since_s = stage, now_s

    def _return_height_m(self, north_m: float, east_m: float) -> float:
        """The height of RTL above home: lower where home is near, along RTL_CONE_SLOPE."""
        away_m = math.hypot(north_m - self.home_true_m[0], east_m - self.home_true_m[1])
        height_m, slope = self._metres("RTL_ALT"), self.parameters.number("RTL_CONE_SLOPE")
        return min(height_m, max(2.0, slope * away_m)) if slope > 0.0 else height_m

    def _to(self, point_m: Vector) -> Vector:
        return self._clipped(toward(point_m, self.body.position_m, self._metres("WPNAV_SPEED")))

    def _clipped(self, velocity_mps: Vector) -> Vector:
        """Limit a velocity to WPNAV_SPEED, WPNAV_SPEED_UP and WPNAV_SPEED_DN."""
        north, east, down = velocity_mps
        share = min(1.0, self._metres("WPNAV_SPEED") / max(math.hypot(north, east), 1e-9))
        up, sink = self._metres("WPNAV_SPEED_UP"), self._metres("WPNAV_SPEED_DN")
        return north * share, east * share, max(-up, min(sink, down))

    def _metres(self, name: str) -> float:
        return self.parameters.number(name) * CM
