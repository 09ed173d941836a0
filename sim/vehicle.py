"""A vehicle that is not there: ``companion.vehicle.Vehicle`` over one map, in virtual time.

The control loop flies it like a real one and much faster: ``now_s`` is virtual, and
``wait_until`` integrates the motion and returns at once.
"""

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from companion.arrays import FloatArray
from companion.vehicle import (
    CommandAnswer,
    EventKind,
    FlightMode,
    LandedState,
    LinkStats,
    OperatorCommand,
    RequestKind,
    RequestStatus,
    Severity,
    SystemStatus,
    TargetReport,
    VehicleEvent,
    VehicleInfo,
    VehicleState,
)
from companion.world.frames import GeoPoint, LocalTie, enu_to_geodetic, enu_to_ned
from companion.world.maps import Map
from sim.autopilot import Autopilot
from sim.dynamics import Disturbance, VelocityLag, follow_velocity
from sim.referee import Referee
from sim.targets import TargetPaths

NOWHERE = GeoPoint(latitude_deg=47.397742, longitude_deg=8.545594, altitude_m=488.0)
"""The local origin on maps without a place on earth: PX4's own default home, in Zurich."""
CHORD_S = 0.05
"""Longest straight piece of a flight; the referee looks at every one."""
HEARTBEAT_PERIOD_S = 1.0
TARGET_PERIOD_S = 0.1

_INFO = VehicleInfo(
    system_id=1, autopilot="px4", version="simulated", needs_stream_before_external=True
)


class SimVehicle:
    """One simulated vehicle over one map; also its clock and its referee.

    Args:
        city: The map. Contacts are counted and never stop the vehicle, as in the paper.
        rng: Source of wind and noise.
        start_enu_m: Where it starts, shape ``(3,)``; the map's launch point by default. The
            autopilot's local origin is the launch point where the map has one, else the start.
        airborne: Start armed in the air, holding, instead of disarmed on the ground or roof.
        lag: How it follows a velocity.
        wind: Gusts left over after the autopilot's own control, in m/s.
        position_noise: Error of the position it reports, in metres.
        targets: Trajectories by system id, one row each, all starting at time 0.
        setpoint_timeout_s: PX4's COM_OF_LOSS_T.
        on_setpoint_loss: The mode of the failsafe; PX4 without a pilot returns.

    Raises:
        ValueError: If neither ``start_enu_m`` nor a launch point is given.
    """

    def __init__(
        self,
        city: Map,
        *,
        rng: np.random.Generator,
        start_enu_m: FloatArray | None = None,
        airborne: bool = False,
        lag: VelocityLag | None = None,
        wind: Disturbance | None = None,
        position_noise: Disturbance | None = None,
        targets: Mapping[int, TargetPaths] | None = None,
        setpoint_timeout_s: float = 1.0,
        on_setpoint_loss: FlightMode = FlightMode.RETURN,
    ) -> None:
        if start_enu_m is None:
            start_enu_m = city.launch_enu_m
        if start_enu_m is None:
            raise ValueError(f"map {city.name} has no launch point: start_enu_m is needed")
        self._city = city
        self._rng = rng
        self._lag = VelocityLag() if lag is None else lag
        self._wind = wind
        self._noise = position_noise

        self._position_enu_m = np.array(start_enu_m, dtype=np.float64)
        if not airborne:
            self._position_enu_m[2] = city.obstacles.floor_m(self._position_enu_m)
        self._velocity_enu_mps: FloatArray = np.zeros(3)
        self._gust_enu_mps = np.zeros(3) if wind is None else wind.sample(rng, (3,))
        self._error_enu_m = (
            np.zeros(3) if position_noise is None else position_noise.sample(rng, (3,))
        )
        self._yaw_rad = 0.0
        self._now_s = 0.0

        zero_enu_m = self._position_enu_m if city.launch_enu_m is None else city.launch_enu_m
        if city.origin is None:
            self._origin = NOWHERE
            self._tie = LocalTie.from_launch(zero_enu_m, NOWHERE)
        else:
            self._origin = enu_to_geodetic(city.origin, zero_enu_m)
            self._tie = LocalTie.from_origins(city.origin, self._origin)

        self._autopilot = Autopilot(
            self._position_enu_m,
            airborne=airborne,
            setpoint_timeout_s=setpoint_timeout_s,
            on_setpoint_loss=on_setpoint_loss,
        )
        self._events: list[VehicleEvent] = []
        self._setpoints_sent = 0
        self._targets = dict(targets or {})
        self._reports: dict[int, TargetReport] = {}
        self._report_targets()
        self.referee = Referee(city, self._position_enu_m)
        self.said: list[tuple[float, Severity, str]] = []
        """Every STATUSTEXT sent, with its time."""
        self.heartbeats: list[tuple[float, SystemStatus]] = []
        """Every HEARTBEAT sent, with its time."""

    # -- what the control loop uses ------------------------------------------------------------

    @property
    def info(self) -> VehicleInfo:
        """Who it is: a PX4."""
        return _INFO

    def now_s(self) -> float:
        """Return the virtual time; 0 at the start."""
        return self._now_s

    def wait_until(self, deadline_s: float) -> None:
        """Integrate the motion until ``deadline_s``; returns at once, never raises."""
        start_s, duration_s = self._now_s, deadline_s - self._now_s
        num_chords = math.ceil(duration_s / CHORD_S - 1e-9)
        for chord in range(1, num_chords + 1):
            self._advance(start_s + duration_s * chord / num_chords)

    def state(self) -> VehicleState:
        """Return the state as the autopilot reports it, noise and all."""
        autopilot = self._autopilot
        status = SystemStatus.ACTIVE if autopilot.armed else SystemStatus.STANDBY
        return VehicleState(
            time_s=self._now_s,
            position_ned_m=self._tie.position_to_local(self._position_enu_m + self._error_enu_m),
            velocity_ned_mps=self._tie.velocity_to_local(self._velocity_enu_mps),
            attitude_rad=np.array((0.0, 0.0, self._yaw_rad)),
            heartbeat_time_s=_last_multiple_s(self._now_s, HEARTBEAT_PERIOD_S),
            mode=autopilot.mode,
            mode_name=autopilot.mode_name,
            armed=autopilot.armed,
            landed=self._landed_state(),
            system_status=SystemStatus.CRITICAL if autopilot.in_failsafe else status,
            ready_to_arm=autopilot.ready_to_arm(self._now_s),
            position_valid=True,
            origin=self._origin,
        )

    def targets(self) -> Mapping[int, TargetReport]:
        """Return the newest report of every target."""
        return self._reports

    def take_events(self) -> Sequence[VehicleEvent]:
        """Return what happened since the last call, and forget it."""
        events, self._events = self._events, []
        return events

    def send_velocity(self, velocity_ned_mps: FloatArray, yaw_rad: float | None = None) -> None:
        """Take one velocity setpoint, as ``Vehicle.send_velocity`` says."""
        velocity_ned_mps = np.asarray(velocity_ned_mps, dtype=np.float64)
        if velocity_ned_mps.shape != (3,) or not np.isfinite(velocity_ned_mps).all():
            raise ValueError(f"velocity must be three finite numbers, got {velocity_ned_mps}")
        self._autopilot.take_setpoint(self._tie.velocity_to_map(velocity_ned_mps), self._now_s)
        self._setpoints_sent += 1
        if yaw_rad is not None:
            self._yaw_rad = yaw_rad

    def request(self, kind: RequestKind, *, altitude_m: float | None = None) -> None:
        """Ask for ``kind``; the answer comes with the next ``wait_until``."""
        self._autopilot.request(kind, altitude_m)

    def request_status(self) -> RequestStatus:
        """Return how far the newest request has come."""
        return self._autopilot.request_status

    def judge_commands(self, judge: Callable[[OperatorCommand], CommandAnswer]) -> None:
        """Do nothing; nobody commands us here."""

    def send_heartbeat(self, status: SystemStatus) -> None:
        """Note a HEARTBEAT in ``heartbeats``."""
        self.heartbeats.append((self._now_s, status))

    def say(self, text: str, severity: Severity = Severity.INFO) -> None:
        """Note a STATUSTEXT in ``said``."""
        self.said.append((self._now_s, severity, text))

    def stats(self) -> LinkStats:
        """Return the count of setpoints; no wire, no packets."""
        return LinkStats(setpoints_sent=self._setpoints_sent)

    def close(self) -> None:
        """Do nothing; there is no transport."""

    # -- what tests and evaluation use -----------------------------------------------------------

    @property
    def position_enu_m(self) -> FloatArray:
        """Return the true position in the map frame, shape ``(3,)``."""
        return self._position_enu_m

    @property
    def contacts(self) -> int:
        """Return how many times it went into an obstacle."""
        return self.referee.contacts

    @property
    def min_clearance_m(self) -> float:
        """Return the smallest true distance from any obstacle so far."""
        return self.referee.min_clearance_m

    def take_over(self, mode: FlightMode) -> None:
        """Be the pilot: choose a mode on the transmitter, which is obeyed at once."""
        self._autopilot.choose(mode, self._now_s)

    # -- inside ------------------------------------------------------------------------------------

    def _advance(self, time_s: float) -> None:
        """Fly one chord that ends at ``time_s``."""
        dt_s = time_s - self._now_s
        autopilot = self._autopilot
        if autopilot.update(self._now_s):
            self._events.append(
                VehicleEvent(
                    self._now_s,
                    EventKind.STATUS_TEXT,
                    "Failsafe activated",
                    Severity.CRITICAL,
                )
            )
        wanted_enu_mps = autopilot.wanted_velocity_enu_mps(self._position_enu_m, self._now_s)
        if autopilot.landed and wanted_enu_mps[2] > 0.0:
            autopilot.landed = False
        if not autopilot.landed:
            self._fly(wanted_enu_mps, dt_s)
        if self._noise is not None:
            self._error_enu_m = self._noise.advance(self._error_enu_m, dt_s=dt_s, rng=self._rng)
        self._now_s = time_s
        self._report_targets()

    def _fly(self, wanted_enu_mps: FloatArray, dt_s: float) -> None:
        controlled_enu_mps, way_enu_m = follow_velocity(
            self._velocity_enu_mps - self._gust_enu_mps, wanted_enu_mps, self._lag, dt_s=dt_s
        )
        position_enu_m = self._position_enu_m + way_enu_m + self._gust_enu_mps * dt_s
        if self._wind is not None:
            self._gust_enu_mps = self._wind.advance(self._gust_enu_mps, dt_s=dt_s, rng=self._rng)
        self._velocity_enu_mps = controlled_enu_mps + self._gust_enu_mps

        descending = wanted_enu_mps[2] < 0.0
        landing = descending and self._autopilot.mode in (FlightMode.LAND, FlightMode.RETURN)
        floor_m = float(self._city.obstacles.floor_m(position_enu_m)) if landing else 0.0
        if position_enu_m[2] <= floor_m:
            position_enu_m[2] = floor_m
            if descending:
                self._velocity_enu_mps = np.zeros(3)
                self._autopilot.touch_down(self._now_s)
        self._position_enu_m = position_enu_m
        self.referee.record(position_enu_m)

    def _landed_state(self) -> LandedState:
        if self._autopilot.landed:
            return LandedState.ON_GROUND
        if self._autopilot.mode is FlightMode.TAKEOFF:
            return LandedState.TAKING_OFF
        if self._autopilot.mode is FlightMode.LAND:
            return LandedState.LANDING
        return LandedState.IN_AIR

    def _report_targets(self) -> None:
        time_s = _last_multiple_s(self._now_s, TARGET_PERIOD_S)
        for system_id, path in self._targets.items():
            last = self._reports.get(system_id)
            if last is not None and last.time_s == time_s:
                continue
            position_enu_m, velocity_enu_mps = path.at(np.array([time_s]))
            self._reports[system_id] = TargetReport(
                time_s=time_s,
                system_id=system_id,
                source="GLOBAL_POSITION_INT",
                position=self._tie.map_to_geodetic(position_enu_m[0]),
                velocity_ned_mps=enu_to_ned(velocity_enu_mps[0]),
                source_time_s=time_s,
            )


def _last_multiple_s(now_s: float, period_s: float) -> float:
    """Return the last multiple of ``period_s`` not after ``now_s``."""
    return period_s * math.floor(now_s / period_s + 1e-9)
