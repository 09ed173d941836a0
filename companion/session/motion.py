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

_STEP_M = 0.4  # between two points of a path; nearer ones would only make the recording larger
_PIECE_S = 1.0
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
class Piece:
    """A piece of a path, of one colour."""

    time_s: float
    """When its end was reached."""
    points_m: list[list[float]]
    color: Color


@dataclass
class Path:
    """A path in pieces of a second or so: the viewer takes its time for each of them, always."""

    _points_m: list[list[float]] = field(default_factory=list)
    _begun_s: float = 0.0
    _time_s: float = 0.0
    _color: Color | None = None
    _other: Color | None = None
    """A colour seen since the last point."""

    def extend(self, time_s: float, position_m: list[float], color: Color) -> Piece | None:
        """Go on to ``position_m``; return the piece that ends before it, if one does."""
        if not self._points_m:
            self._points_m, self._color = [position_m], color
            self._begun_s = self._time_s = time_s
            return None
        if color != self._color:
            self._other = color
        if np.linalg.norm(np.subtract(position_m, self._points_m[-1])) < _STEP_M:
            return None
        piece = None
        color, self._other = self._other or color, None
        if color != self._color or time_s - self._begun_s > _PIECE_S:
            piece = self.finish()
            self._begun_s, self._color = self._time_s, color
        self._points_m.append(position_m)
        self._time_s = time_s
        return piece

    def finish(self) -> Piece | None:
        """Return what is there of the last piece, and begin the next at its end."""
        points_m, self._points_m = self._points_m, self._points_m[-1:]
        if len(points_m) < 2 or self._color is None:
            return None
        return Piece(self._time_s, points_m, self._color)


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
