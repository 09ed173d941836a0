"""The vehicle's state, put together from its messages. No I/O; time is an argument."""

import math
from collections.abc import Callable, Mapping
from enum import IntEnum
from typing import Any, TypeVar

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.arrays import FloatArray
from companion.link.autopilots import Autopilot
from companion.link.boot_clock import BootClock
from companion.link.frame_check import FrameCheck
from companion.link.statustext import TextAssembler
from companion.link.targets import Targets, geo_point
from companion.vehicle import (
    FRAME_RESIDUAL_M,
    EventKind,
    FlightMode,
    LandedState,
    Severity,
    SystemStatus,
    TargetReport,
    VehicleEvent,
    VehicleState,
)
from companion.world.frames import GeoPoint

_ENOUGH_S = {dialect.MAVLINK_MSG_ID_ATTITUDE: 0.04, dialect.MAVLINK_MSG_ID_ODOMETRY: 0.08}
"""No more often than this are these looked at."""
_REBOOT_MS = 1000
"""The autopilot's clock this much back is a reboot; less is packets out of order."""
_CLOCK_WRAPS_MS = 1 << 31
"""A step back beyond this is the 32-bit clock starting over after 49.7 days."""
_ORIGIN_SAME_DEG = 5e-7
_ORIGIN_SAME_M = 0.1
"""Origins closer than this differ by rounding (GPS_GLOBAL_ORIGIN counts 1e-7 degrees)."""
_ESTIMATOR_FRESH_S = 5.0
"""Flags older than this vouch for nothing; they come once a second or faster."""

_Known = TypeVar("_Known", bound=IntEnum)


class Telemetry:
    """What the vehicle's messages say of it. Feed only messages of the autopilot itself."""

    def __init__(self, autopilot: Autopilot) -> None:
        self._autopilot = autopilot
        self.version = ""
        """Firmware version in words, once AUTOPILOT_VERSION was heard."""
        self.home_altitude_m: float | None = None
        """Above mean sea level, of HOME_POSITION."""
        self.frame_epoch = 0
        self._texts = TextAssembler()
        self._decoded_s: dict[int, float] = {}
        self._frame_check = FrameCheck(autopilot.earth_radius_m)
        self._boot_clock = BootClock()
        self.punctual = True
        """Whether messages now come with the time of reading; else only their own stamp tells."""
        self._forget()
        self.handlers: Mapping[int, Callable[[Any, float], list[VehicleEvent]]] = {
            dialect.MAVLINK_MSG_ID_HEARTBEAT: self._heartbeat,
            dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: self._local_position,
            dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: self._global_position,
            dialect.MAVLINK_MSG_ID_ATTITUDE: self._attitude,
            dialect.MAVLINK_MSG_ID_SYS_STATUS: self._sys_status,
            dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: self._extended_sys_state,
            autopilot.estimator_message_id: self._estimator,
            dialect.MAVLINK_MSG_ID_ODOMETRY: self._odometry,
            dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: self._origin,
            dialect.MAVLINK_MSG_ID_HOME_POSITION: self._home,
            dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION: self._autopilot_version,
            dialect.MAVLINK_MSG_ID_STATUSTEXT: self._status_text,
        }
        """What to call with a decoded message and its arrival, by message id."""

    def _forget(self) -> None:
        self._boot_ms: int | None = None
        self.heartbeat_time_s: float | None = None
        self.mode = FlightMode.OTHER
        self.mode_name = ""
        self.armed = False
        self._system_status = SystemStatus.UNINIT
        self.landed = LandedState.UNKNOWN
        self._position_time_s: float | None = None
        self._position_boot_ms = 0
        self.global_position: TargetReport | None = None
        """The vehicle's newest GLOBAL_POSITION_INT that was looked at."""
        self._frame_check.forget()
        self._boot_clock.forget()
        self._position_ned_m = _frozen(0.0, 0.0, 0.0)
        self._velocity_ned_mps = _frozen(0.0, 0.0, 0.0)
        self._attitude_rad: FloatArray | None = None
        self._prearm_ok: bool | None = None
        self._battery_fraction: float | None = None
        self._estimator_flags = 0
        self._estimator_time_s = -math.inf
        self._reset_counter: int | None = None
        self.origin: GeoPoint | None = None

    def snapshot(self, now_s: float) -> VehicleState | None:
        """Return the state; ``None`` until heartbeat, position and attitude were heard."""
        if (
            self.heartbeat_time_s is None
            or self._position_time_s is None
            or self._attitude_rad is None
        ):
            return None
        vouched = now_s - self._estimator_time_s <= _ESTIMATOR_FRESH_S
        return VehicleState(
            time_s=self._position_time_s,
            position_ned_m=self._position_ned_m,
            velocity_ned_mps=self._velocity_ned_mps,
            attitude_rad=self._attitude_rad,
            heartbeat_time_s=self.heartbeat_time_s,
            mode=self.mode,
            mode_name=self.mode_name,
            armed=self.armed,
            landed=self.landed,
            system_status=self._system_status,
            ready_to_arm=self._autopilot.ready_to_arm(self._system_status, self._prearm_ok),
            position_valid=vouched
            and self._autopilot.position_valid(self._estimator_flags, self.landed),
            origin=self.origin,
            frame_epoch=self.frame_epoch,
            battery_fraction=self._battery_fraction,
            frame_residual_m=self._frame_check.residual_m(now_s),
            measured_s=self._boot_clock.time_s(self._position_boot_ms),
        )

    def altitude_amsl_m(self) -> float | None:
        """Return the vehicle's own altitude, ``None`` while origin or position are unknown."""
        if self.origin is None or self._position_time_s is None:
            return None
        return self.origin.altitude_m - float(self._position_ned_m[2])

    def origin_is_doubtful(self, now_s: float) -> bool:
        """Return whether local and global position contradict each other: ask for the origin."""
        residual_m = self._frame_check.residual_m(now_s)
        return residual_m is not None and residual_m > FRAME_RESIDUAL_M

    def overdue_texts(self, now_s: float) -> list[VehicleEvent]:
        """Return texts whose last chunk never came."""
        return _text_events(self._texts.overdue(now_s), now_s)

    def _heartbeat(self, message: Any, now_s: float) -> list[VehicleEvent]:
        self.heartbeat_time_s = now_s
        self.mode = self._autopilot.mode(message.custom_mode)
        self.mode_name = self._autopilot.mode_name(message.custom_mode)
        self.armed = bool(message.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED)
        self._system_status = _known(SystemStatus, message.system_status, SystemStatus.UNINIT)
        return []

    def _local_position(self, message: Any, now_s: float) -> list[VehicleEvent]:
        events = self._check_clock(message.time_boot_ms, now_s)
        if self.punctual:
            self._boot_clock.hear(message.time_boot_ms, now_s)
        values = (message.x, message.y, message.z, message.vx, message.vy, message.vz)
        if all(map(math.isfinite, values)):
            self._position_ned_m = _frozen(*values[:3])
            self._velocity_ned_mps = _frozen(*values[3:])
            self._position_time_s = now_s
            self._position_boot_ms = message.time_boot_ms
        return events

    def wants(self, message_id: int, now_s: float) -> bool:
        """Return whether a message is worth decoding now.

        PX4 sends its attitude a hundred times a second and the odometry, of which a counter is
        read, thirty times: most of what decoding costs, and the newest says it all.
        """
        if message_id == dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT:
            return self._frame_check.is_due(now_s)
        period_s = _ENOUGH_S.get(message_id)
        if period_s is None:
            return message_id in self.handlers
        if now_s - self._decoded_s.get(message_id, -math.inf) < period_s:
            return False
        self._decoded_s[message_id] = now_s
        return True

    def _global_position(self, message: Any, now_s: float) -> list[VehicleEvent]:
        heard = Targets((0,))
        heard.global_position(message, 0, now_s)
        self.global_position = heard.reports().get(0)
        if self.global_position is None or self.origin is None or self._position_time_s is None:
            return []
        self._frame_check.compare(
            self.global_position.position,
            self.origin,
            self._position_ned_m,
            self._velocity_ned_mps,
            global_after_local_s=(message.time_boot_ms - self._position_boot_ms) * 1e-3,
            now_s=now_s,
        )
        return []

    def _attitude(self, message: Any, now_s: float) -> list[VehicleEvent]:
        events = self._check_clock(message.time_boot_ms, now_s)
        if math.isfinite(message.roll + message.pitch + message.yaw):
            self._attitude_rad = _frozen(message.roll, message.pitch, message.yaw)
        return events

    def _check_clock(self, boot_ms: int, now_s: float) -> list[VehicleEvent]:
        before_ms, self._boot_ms = self._boot_ms, boot_ms
        if before_ms is None or not _REBOOT_MS < before_ms - boot_ms < _CLOCK_WRAPS_MS:
            return []
        self._forget()
        self._boot_ms = boot_ms
        self.home_altitude_m = None
        self.frame_epoch += 1
        text = f"the autopilot rebooted: its clock went from {before_ms} to {boot_ms} ms"
        return [VehicleEvent(now_s, EventKind.REBOOT, text, Severity.CRITICAL)]

    def _sys_status(self, message: Any, now_s: float) -> list[VehicleEvent]:
        prearm = dialect.MAV_SYS_STATUS_PREARM_CHECK
        if message.onboard_control_sensors_present & prearm:
            self._prearm_ok = bool(message.onboard_control_sensors_health & prearm)
        percent = message.battery_remaining
        self._battery_fraction = percent / 100.0 if 0 <= percent <= 100 else None
        return []

    def _extended_sys_state(self, message: Any, now_s: float) -> list[VehicleEvent]:
        self.landed = _known(LandedState, message.landed_state, LandedState.UNKNOWN)
        return []

    def _estimator(self, message: Any, now_s: float) -> list[VehicleEvent]:
        self._estimator_flags = message.flags
        self._estimator_time_s = now_s
        return []

    def _odometry(self, message: Any, now_s: float) -> list[VehicleEvent]:
        if self._reset_counter not in (None, message.reset_counter):
            self.frame_epoch += 1
            self._frame_check.forget()
        self._reset_counter = message.reset_counter
        return []

    def _origin(self, message: Any, now_s: float) -> list[VehicleEvent]:
        origin = geo_point(
            message.latitude * 1e-7, message.longitude * 1e-7, message.altitude * 1e-3
        )
        if origin is None:
            return []
        if self.origin is None:
            self.origin = origin
        elif _moved(self.origin, origin):
            self.frame_epoch += 1
            self.origin = origin
            self._frame_check.forget()
        return []

    def _home(self, message: Any, now_s: float) -> list[VehicleEvent]:
        home = geo_point(message.latitude * 1e-7, message.longitude * 1e-7, message.altitude * 1e-3)
        if home is not None:
            self.home_altitude_m = home.altitude_m
        return []

    def _autopilot_version(self, message: Any, now_s: float) -> list[VehicleEvent]:
        self.version = _version(message.flight_sw_version)
        return []

    def _status_text(self, message: Any, now_s: float) -> list[VehicleEvent]:
        return _text_events(self._texts.add(message, now_s), now_s)


def _version(packed: int) -> str:
    """Return ``1.18.0 beta`` for flight_sw_version of AUTOPILOT_VERSION."""
    major, minor, patch, kind = (packed >> shift & 0xFF for shift in (24, 16, 8, 0))
    stage = "dev"
    for lowest, name in ((64, "alpha"), (128, "beta"), (192, "rc"), (255, "")):
        stage = name if kind >= lowest else stage
    return f"{major}.{minor}.{patch} {stage}".rstrip()


def _moved(before: GeoPoint, after: GeoPoint) -> bool:
    return (
        abs(after.latitude_deg - before.latitude_deg) > _ORIGIN_SAME_DEG
        or abs(after.longitude_deg - before.longitude_deg) > _ORIGIN_SAME_DEG
        or abs(after.altitude_m - before.altitude_m) > _ORIGIN_SAME_M
    )


def _text_events(texts: list[tuple[int, str]], now_s: float) -> list[VehicleEvent]:
    return [
        VehicleEvent(now_s, EventKind.STATUS_TEXT, text, _known(Severity, level, Severity.DEBUG))
        for level, text in texts
    ]


def _known(kind: type[_Known], value: int, otherwise: _Known) -> _Known:
    """Return the member, or ``otherwise`` for a number the standard does not have."""
    try:
        return kind(value)
    except ValueError:
        return otherwise


def _frozen(*components: float) -> FloatArray:
    array = np.array(components, dtype=np.float64)
    array.setflags(write=False)
    return array
