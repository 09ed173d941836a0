"""What moves in the 3-D view, from ticks to arrays; nothing here knows Rerun.

Everything is in the map frame, ENU with z up; the body frame is x forward, y left, z up.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from companion.arrays import FloatArray
from companion.session import colors
from companion.session.colors import Color
from companion.session.records import SessionStart, Tick

_SEGMENT_M = 0.4  # of the path; shorter pieces would only make the recording larger
_COURSE_TIME_S = 1.5  # the chase camera turns that slowly
_FAR_MARGINS = 4.0  # of clearance beyond the margin: blue
_COURSE_SPEED_MPS = 0.5  # below it the course is noise


def attitude_enu(attitude_rad: FloatArray) -> FloatArray:
    """Turn MAVLink attitudes into rotations from the body to the map frame.

    Args:
        attitude_rad: Roll, pitch, yaw of a forward-right-down body in NED, shape ``(..., 3)``.

    Returns:
        Quaternions x, y, z, w of the forward-left-up body in ENU, shape ``(..., 4)``.
    """
    roll, pitch, yaw = np.moveaxis(0.5 * attitude_rad, -1, 0)
    return _quaternion(roll, -pitch, 0.25 * np.pi - yaw)


def yaw_enu(course_rad: FloatArray) -> FloatArray:
    """Return quaternions x, y, z, w that turn x to ``course_rad``, from east toward north."""
    return _quaternion(0.0 * course_rad, 0.0 * course_rad, 0.5 * course_rad)


def _quaternion(roll: FloatArray, pitch: FloatArray, yaw: FloatArray) -> FloatArray:
    """Return x, y, z, w of a z-y-x rotation from half angles."""
    (sr, sp, sy), (cr, cp, cy) = np.sin((roll, pitch, yaw)), np.cos((roll, pitch, yaw))
    return np.stack(
        (
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        ),
        axis=-1,
    )


@dataclass
class Course:
    """Where the vehicle is going, smoothed: what the chase camera looks along."""

    course_rad: float | None = None
    """From east toward north; ``None`` before the first tick."""
    _time_s: float = 0.0
    _velocity_mps: FloatArray = field(default_factory=lambda: np.zeros(2))

    def update(self, tick: Tick) -> float:
        """Take one tick and return the course; the nose counts until the vehicle moves."""
        if self.course_rad is None:
            yaw_rad = tick.attitude_rad[2] if tick.attitude_rad else 0.0
            self.course_rad = 0.5 * np.pi - yaw_rad
        share = min(1.0, max(0.0, tick.time_s - self._time_s) / _COURSE_TIME_S)
        velocity_mps = np.array((tick.velocity_enu_mps or [0.0, 0.0])[:2])
        self._velocity_mps += share * (velocity_mps - self._velocity_mps)
        self._time_s = tick.time_s
        if np.hypot(*self._velocity_mps) > _COURSE_SPEED_MPS:
            self.course_rad = float(np.arctan2(self._velocity_mps[1], self._velocity_mps[0]))
        return self.course_rad


@dataclass(frozen=True, slots=True)
class Segment:
    """A straight piece of a path."""

    time_s: float
    """When its end was reached."""
    start_m: list[float]
    end_m: list[float]
    color: Color


@dataclass
class Path:
    """A path in pieces that are long enough to matter and of one colour each."""

    _last_m: list[float] | None = None
    _last_color: Color | None = None

    def extend(self, time_s: float, position_m: list[float], color: Color) -> Segment | None:
        """Go on to ``position_m``; return the next piece when it is complete."""
        if self._last_m is None:
            self._last_m, self._last_color = position_m, color
            return None
        moved_m = np.linalg.norm(np.subtract(position_m, self._last_m))
        if moved_m < _SEGMENT_M and not (color != self._last_color and moved_m > 0.0):
            return None
        segment = Segment(time_s, self._last_m, position_m, color)
        self._last_m, self._last_color = position_m, color
        return segment


def path_color(tick: Tick, margin_m: float) -> Color:
    """Return what the colour of the path tells: who decided, and how close it was."""
    if tick.clearance_m is not None and tick.clearance_m < margin_m:
        return colors.DANGER
    if tick.intervened:
        return colors.SHIELDED
    # zero is what is streamed while the autopilot takes off or holds
    return colors.MEASURED if tick.safe_enu_mps and any(tick.safe_enu_mps) else colors.IDLE


def clearance_color(tick: Tick, margin_m: float) -> Color:
    """Return the colour of a clearance: red inside the margin, through yellow to blue far off."""
    if tick.clearance_m is None:
        return colors.IDLE
    share = (tick.clearance_m - margin_m) / (_FAR_MARGINS * max(0.1, margin_m))
    return colors.scale(share)


def painter(start: SessionStart) -> Callable[[Tick], Color]:
    """Return what colours the path: who decided, or the flight mode where no actor of ours flew."""
    if start.actor.name:
        return lambda tick: path_color(tick, start.margin_m)
    modes: list[str] = []

    def by_mode(tick: Tick) -> Color:
        if tick.mode not in modes:
            modes.append(tick.mode)
        return colors.bright(colors.band_color(tick.mode, modes.index(tick.mode)))

    return by_mode


def vectors(rows: Sequence[list[float] | None]) -> FloatArray:
    """Return known vectors as an array of shape ``(N, 3)``, also for none."""
    return np.array(rows, dtype=float).reshape(-1, 3)
