"""Where the vehicle was and how fast, sampled from a log at a steady rate."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import msgspec
import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.arrays import FloatArray
from companion.review.log_file import Frame
from companion.review.setpoints import Setpoints
from companion.review.story import Story
from companion.session.records import Tick
from companion.world.frames import GeoPoint, geodetic_to_enu, ned_to_enu

PERIOD_S = 0.1
_FRESH_S = 1.0
_SETPOINT_FRESH_S = 0.5
_FARTHEST_M = 1e6
_JUMP_M = 1.5
_TOLD_JUMPS, _CALM_S = 3, 10.0  # of those that follow each other faster, the first few are told
_LOCAL = dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED
_GLOBAL = dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
_ATTITUDE = dialect.MAVLINK_MSG_ID_ATTITUDE
_WANTED = dialect.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED
_STATUS = dialect.MAVLINK_MSG_ID_SYS_STATUS
_HEARTBEAT = dialect.MAVLINK_MSG_ID_HEARTBEAT
_ORIGIN = dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN
_SAMPLED = (_HEARTBEAT, _LOCAL, _GLOBAL, _ATTITUDE, _WANTED, _STATUS)


class MotionLog:
    """Keeps the newest frame of each kind and decodes it when a sample is due.

    Positions are ENU metres around the local origin, or around the first place on earth where
    the log has no local position.
    """

    def __init__(self, story: Story, setpoints: Setpoints, height: Callable[..., None]) -> None:
        self._story = story
        self._setpoints = setpoints
        self._height = height
        self._decoder = dialect.MAVLink(None)
        self._newest: dict[int, Frame] = {}
        self._global_origin: GeoPoint | None = None
        self._has_local = False
        self._others: dict[int, tuple[float, FloatArray]] = {}
        self._last: tuple[float, FloatArray, FloatArray] | None = None
        self._jumps: list[tuple[float, float]] = []
        self.ground_m: float | None = None
        """Height of the ground at the take-off."""
        self.origin: GeoPoint | None = None
        """Where the local frame is zero on earth."""
        self.ticks: list[Tick] = []

    @property
    def earth(self) -> GeoPoint | None:
        """Return where the positions are zero on earth, if the log tells."""
        return self.origin if self._has_local else self._global_origin

    def take(self, frame: Frame) -> None:
        """Keep one frame."""
        if frame.system_id == self._story.vehicle:
            if frame.message_id in _SAMPLED:
                self._newest[frame.message_id] = frame
            if frame.message_id == _ORIGIN:
                self._newest[_ORIGIN] = frame
                fields = self._fields(_ORIGIN, frame.time_s)
                if fields is not None:
                    self.origin = GeoPoint(
                        fields.latitude * 1e-7, fields.longitude * 1e-7, fields.altitude * 1e-3
                    )
        elif frame.message_id == _GLOBAL:
            self._newest[-frame.system_id] = frame

    def sample(self, now_s: float) -> None:
        """Add the tick of ``now_s``."""
        story = self._story
        attitude = self._fields(_ATTITUDE, now_s)
        position, velocity, moved_s = self._place(now_s)
        if position is not None:
            self._check_jump(moved_s, position, velocity)
            if self.ground_m is None or not (story.in_air or story.armed):
                self.ground_m = float(position[2])
            self._height(now_s, float(position[2]) - self.ground_m)
        status = self._fields(_STATUS, now_s, 10.0)
        percent = -1 if status is None else status.battery_remaining
        setpoint_age_s = now_s - self._setpoints.time_s
        sent = None
        if setpoint_age_s < _SETPOINT_FRESH_S:
            sent = self._sent(None if attitude is None else attitude.yaw)
        self.ticks.append(
            Tick(
                time_s=now_s,
                position_enu_m=None if position is None else position.tolist(),
                velocity_enu_mps=None if velocity is None else velocity.tolist(),
                attitude_rad=None
                if attitude is None
                else [attitude.roll, attitude.pitch, attitude.yaw],
                target_enu_m=self._other(now_s),
                safe_enu_mps=None if sent is None else sent.tolist(),
                proposed_enu_mps=self._wanted(now_s) if sent is None else None,
                mode=story.now("mode"),
                armed=story.armed,
                battery_fraction=percent / 100.0 if 0 <= percent <= 100 else None,
                link_age_s=self._age(_HEARTBEAT, now_s),
                position_age_s=self._age(_LOCAL if self._has_local else _GLOBAL, now_s),
            )
        )

    def finish(self) -> None:
        """Tell the jumps that were too many to be told one by one."""
        more = self._jumps[_TOLD_JUMPS:]
        if more:
            largest_m = max(distance_m for _, distance_m in more)
            self._story.warn(
                more[0][0],
                f"the position JUMPED {len(more)} more times until {more[-1][0]:.1f} s, by up to "
                f"{largest_m:.1f} m: it is noisy, or its estimator does not settle",
            )
        self._jumps = []

    def _age(self, message_id: int, now_s: float) -> float | None:
        frame = self._newest.get(message_id)
        return None if frame is None else now_s - frame.time_s

    def _fields(self, message_id: int, now_s: float, fresh_s: float = _FRESH_S) -> Any | None:
        frame = self._newest.get(message_id)
        if frame is None or now_s - frame.time_s > fresh_s:
            return None
        try:
            return self._decoder.decode(bytearray(frame.data))
        except dialect.MAVError:
            return None

    def _place(self, now_s: float) -> tuple[FloatArray | None, FloatArray | None, float]:
        """Return position, velocity and when the autopilot measured them."""
        local = self._fields(_LOCAL, now_s)
        if local is not None:
            self._has_local = True
            position = ned_to_enu(np.array((local.x, local.y, local.z)))
            velocity = ned_to_enu(np.array((local.vx, local.vy, local.vz)))
            return *_sane(position, velocity), local.time_boot_ms * 1e-3
        if self._has_local:
            return None, None, now_s
        at = self._fields(_GLOBAL, now_s)
        if at is None or (at.lat == 0 and at.lon == 0):
            return None, None, now_s
        point = GeoPoint(at.lat * 1e-7, at.lon * 1e-7, at.alt * 1e-3)
        if self._global_origin is None:
            self._global_origin = point
        velocity = ned_to_enu(np.array((at.vx, at.vy, at.vz)) * 1e-2)
        position = geodetic_to_enu(self._global_origin, point)
        return *_sane(position, velocity), at.time_boot_ms * 1e-3

    def _other(self, now_s: float) -> list[float] | None:
        """Return where the one other system is that reports a position, if there is one."""
        origin = self.earth
        others = [number for number in self._newest if number < 0]
        if origin is None or len(others) != 1:
            return None
        at = self._fields(others[0], now_s, 5.0)
        if at is None or (at.lat == 0 and at.lon == 0):
            return None
        place = geodetic_to_enu(origin, GeoPoint(at.lat * 1e-7, at.lon * 1e-7, at.alt * 1e-3))
        return place.tolist() if np.abs(place).max() < _FARTHEST_M else None

    def _wanted(self, now_s: float) -> list[float] | None:
        """Return the velocity that the autopilot itself is after, if it says so."""
        wanted = self._fields(_WANTED, now_s, 0.5)
        if wanted is None:
            return None
        velocity = ned_to_enu(np.array((wanted.vx, wanted.vy, wanted.vz), dtype=np.float64))
        return velocity.tolist() if np.isfinite(velocity).all() else None

    def _sent(self, yaw_rad: float | None) -> FloatArray | None:
        velocity = self._setpoints.velocity_ned_mps
        if velocity is None:
            return None
        if self._setpoints.in_body:
            if yaw_rad is None:
                return None
            ahead, right = velocity[:2]
            cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
            velocity = np.array((cos * ahead - sin * right, sin * ahead + cos * right, velocity[2]))
        return ned_to_enu(velocity)

    def _check_jump(
        self, moved_s: float, position: FloatArray, velocity: FloatArray | None
    ) -> None:
        """Tell a step of the position that the velocity does not explain."""
        last, speed = self._last, velocity if velocity is not None else np.zeros(3)
        self._last = (moved_s, position, speed)
        if last is None or not 0.0 < moved_s - last[0] < 2.0:
            return
        since_s = moved_s - last[0]
        expected = last[1] + 0.5 * (last[2] + speed) * since_s
        jump = position - expected
        allowed_m = _JUMP_M + 0.5 * float(np.linalg.norm(speed)) * since_s
        distance_m = float(np.linalg.norm(jump))
        if distance_m > allowed_m:
            now_s = self.ticks[-1].time_s + PERIOD_S if self.ticks else 0.0
            if self._jumps and now_s - self._jumps[-1][0] > _CALM_S:
                self.finish()
            self._jumps.append((now_s, distance_m))
            east, north, up = jump
            if len(self._jumps) <= _TOLD_JUMPS:
                self._story.warn(
                    now_s,
                    f"the position JUMPED by {distance_m:.1f} m "
                    f"({east:+.1f} east, {north:+.1f} north, {up:+.1f} up)",
                )


def _sane(
    position: FloatArray, velocity: FloatArray
) -> tuple[FloatArray | None, FloatArray | None]:
    """Return what can be drawn; NaN and nonsense cannot."""
    placed = bool(np.isfinite(position).all() and np.abs(position).max() < _FARTHEST_M)
    moving = bool(np.isfinite(velocity).all() and np.abs(velocity).max() < _FARTHEST_M)
    return position if placed else None, velocity if moving else None


def with_rates(
    ticks: Sequence[Tick], rates: Sequence[tuple[float, Mapping[str, float]]]
) -> list[Tick]:
    """Return the ticks, the first of each second with the rates of that second."""
    by_second = {int(second): dict(rate) for second, rate in rates}
    out = []
    for tick in ticks:
        found = by_second.pop(int(tick.time_s), None)
        out.append(tick if found is None else msgspec.structs.replace(tick, rates_hz=found))
    return out
