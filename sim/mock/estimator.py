"""PX4's estimator as seen from outside: its life cycle, its origin and its errors.

Three frames are kept apart. *True* is where the point mass is, in NED around the place of the
first boot. *Global* is what GLOBAL_POSITION_INT says: true plus the estimator's error. *Local*
is LOCAL_POSITION_NED: global seen from the estimator's origin, which may move.
"""

from dataclasses import replace

from companion.world.frames import GeoPoint
from sim.mock.dynamics import ZERO, Vector
from sim.mock.geodesy import Projection

GLITCH = 1024
FLAGS_BOOT = 0x00A4
FLAGS_ALIGNED = 0x00E5
FLAGS_READY = 0x03FF
FLAGS_ARMED = 0x037F
FLAGS_LOST = 0x0065

GPS_LOSS_TOLERATED_S = 5.3
"""Time of dead reckoning after which PX4 calls its position invalid (measured)."""
RUNAWAY_MPS = 2.0
"""How fast the estimate drifts off once GPS is gone."""

_RESETS_AT_BOOT = ((0.0, 4), (0.14, 6), (0.19, 8), (0.28, 10), (0.47, 11))
"""Share of the boot time after which ODOMETRY.reset_counter shows these counts (recorded)."""


def add(a: Vector, b: Vector) -> Vector:
    """Return the sum of two vectors."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def subtract(a: Vector, b: Vector) -> Vector:
    """Return the difference of two vectors."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


class Estimator:
    """What the vehicle believes about its position.

    Args:
        place: Where true NED zero lies.
        boot_s: Time from power-up to ready; PX4 SIH takes 4.6 s.
    """

    def __init__(self, place: GeoPoint, boot_s: float) -> None:
        self.boot_s = boot_s
        self._truth = Projection(place)
        self.error_m: Vector = ZERO
        self.origin_shift_m: Vector = ZERO
        self.origin_count = 0
        """Rises whenever GPS_GLOBAL_ORIGIN changes."""
        self.extra_resets = 0
        self.glitching = False
        self.gps_lost_at_s: float | None = None

    def local_known(self, now_s: float) -> bool:
        """Whether LOCAL_POSITION_NED and ODOMETRY are sent."""
        return now_s >= 0.09 * self.boot_s

    def attitude_known(self, now_s: float) -> bool:
        """Whether ATTITUDE, HEARTBEAT and the origin are sent."""
        return now_s >= 0.3 * self.boot_s

    def global_known(self, now_s: float) -> bool:
        """Whether GLOBAL_POSITION_INT and HOME_POSITION are sent: absent until valid."""
        return now_s >= 0.5 * self.boot_s

    def ready(self, now_s: float) -> bool:
        """Whether position and velocity are good enough to fly on."""
        lost = self.gps_lost_at_s
        return now_s >= self.boot_s - 1e-9 and (lost is None or now_s - lost < GPS_LOSS_TOLERATED_S)

    def flags(self, now_s: float, *, armed: bool) -> int:
        """Return ESTIMATOR_STATUS.flags."""
        if self.gps_lost_at_s is not None and not self.ready(now_s):
            return FLAGS_LOST
        if now_s < 0.5 * self.boot_s:
            return FLAGS_BOOT
        if now_s < 0.75 * self.boot_s:
            return FLAGS_ALIGNED
        return (FLAGS_ARMED if armed else FLAGS_READY) | (GLITCH if self.glitching else 0)

    def reset_counter(self, now_s: float) -> int:
        """Return ODOMETRY.reset_counter."""
        count = max(n for share, n in _RESETS_AT_BOOT if now_s >= share * self.boot_s)
        return (count + self.extra_resets) % 256

    def drift_m(self, now_s: float, dt_s: float) -> Vector:
        """Return by how much the estimate runs away in ``dt_s``, once GPS is lost."""
        lost = self.gps_lost_at_s is not None and not self.ready(now_s)
        return (RUNAWAY_MPS * dt_s, 0.0, 0.0) if lost else ZERO

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
        latitude, longitude = self._truth.to_geodetic(global_m[0], global_m[1])
        reference = self._truth.reference
        return replace(
            reference,
            latitude_deg=latitude,
            longitude_deg=longitude,
            altitude_m=reference.altitude_m - global_m[2],
        )
