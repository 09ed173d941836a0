"""An estimator as seen from outside: where the vehicle believes to be, and how wrong it is.

Three frames are kept apart. *True* is where the point mass is, in NED around the place of the
first boot. *Global* is what GLOBAL_POSITION_INT says: true plus the estimator's error. *Local*
is LOCAL_POSITION_NED: global seen from the estimator's origin, which may move.
"""

from abc import ABC, abstractmethod

from companion.world.frames import GeoPoint
from sim.mock.dynamics import ZERO, Vector
from sim.mock.geodesy import Projection

_POINTS_KEPT = 4


def add(a: Vector, b: Vector) -> Vector:
    """Return the sum of two vectors."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def subtract(a: Vector, b: Vector) -> Vector:
    """Return the difference of two vectors."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


class Estimator(ABC):
    """What the vehicle believes about its position; when it knows what is the autopilot's own.

    Args:
        projection: Around the place where true NED zero lies, as the autopilot does it.
        boot_s: Time from power-up to ready.
    """

    def __init__(self, projection: Projection, boot_s: float) -> None:
        self.boot_s = boot_s
        self._truth = projection
        self.error_m: Vector = ZERO
        self.origin_shift_m: Vector = ZERO
        self.origin_count = 0
        """Rises whenever GPS_GLOBAL_ORIGIN changes."""
        self.extra_resets = 0
        self.glitching = False
        self.gps_lost_at_s: float | None = None
        self._points: dict[Vector, GeoPoint] = {}

    @abstractmethod
    def attitude_known(self, now_s: float) -> bool:
        """Whether ATTITUDE is sent."""

    @abstractmethod
    def local_known(self, now_s: float) -> bool:
        """Whether LOCAL_POSITION_NED is sent."""

    @abstractmethod
    def global_known(self, now_s: float) -> bool:
        """Whether GLOBAL_POSITION_INT holds a position."""

    @abstractmethod
    def ready(self, now_s: float) -> bool:
        """Whether position and velocity are good enough to fly on."""

    @abstractmethod
    def drift_m(self, now_s: float, dt_s: float) -> Vector:
        """Return by how much the estimate runs away in ``dt_s``, once GPS is lost."""

    def reset(self, step_m: Vector) -> None:
        """Jump by ``step_m`` and count the reset, as after a re-alignment."""
        self.error_m = add(self.error_m, step_m)
        self.extra_resets += 1

    def move_origin(self, shift_m: Vector) -> None:
        """Move the local origin by ``shift_m``; the global position stays."""
        self.origin_shift_m = add(self.origin_shift_m, shift_m)
        self.origin_count += 1
        self.extra_resets += 1

    def to_local(self, true_m: Vector) -> Vector:
        """Return the believed local position of a true one."""
        return subtract(add(true_m, self.error_m), self.origin_shift_m)

    def to_true(self, local_m: Vector) -> Vector:
        """Return where a local position really lies."""
        return subtract(add(local_m, self.origin_shift_m), self.error_m)

    def geodetic(self, true_m: Vector) -> GeoPoint:
        """Return the believed latitude, longitude and altitude of a true position."""
        return self._at(add(true_m, self.error_m))

    def altitude_m(self, true_m: Vector) -> float:
        """Return the believed altitude of a true position, AMSL."""
        return self._truth.reference.altitude_m - (true_m[2] + self.error_m[2])

    def origin(self) -> GeoPoint:
        """Return GPS_GLOBAL_ORIGIN."""
        return self._at(self.origin_shift_m)

    def gps(self, true_m: Vector) -> GeoPoint:
        """Return what the receiver says: true, or off by the error while it glitches."""
        return self._at(add(true_m, self.error_m) if self.glitching else true_m)

    def from_geodetic(self, point: GeoPoint) -> Vector:
        """Return the true position that the vehicle believes to be at ``point``."""
        north, east = self._truth.to_local(point.latitude_deg, point.longitude_deg)
        down = self._truth.reference.altitude_m - point.altitude_m
        return subtract((north, east, down), self.error_m)

    def _at(self, global_m: Vector) -> GeoPoint:
        point = self._points.get(global_m)  # many messages of one moment say the same place
        if point is None:
            latitude, longitude = self._truth.to_geodetic(global_m[0], global_m[1])
            altitude_m = self._truth.reference.altitude_m - global_m[2]
            point = GeoPoint(latitude, longitude, altitude_m)
            if len(self._points) >= _POINTS_KEPT:
                del self._points[next(iter(self._points))]
            self._points[global_m] = point
        return point
