"""The life cycle of PX4's estimator (EKF2)."""

from sim.mock.dynamics import ZERO, Vector
from sim.mock.estimator import Estimator

GLITCH = 1024
FLAGS_BOOT = 0x00A4
FLAGS_ALIGNED = 0x00E5
FLAGS_READY = 0x03FF
FLAGS_MOVING = 0x037F
FLAGS_LOST = 0x0065

GPS_LOSS_TOLERATED_S = 5.3
"""Time of dead reckoning after which PX4 calls its position invalid (measured)."""
RUNAWAY_MPS = 2.0
"""How fast the estimate drifts off once GPS is gone."""

_RESETS_AT_BOOT = ((0.0, 4), (0.14, 6), (0.19, 8), (0.28, 10), (0.47, 11))
"""Share of the boot time after which ODOMETRY.reset_counter shows these counts (recorded)."""


class Px4Estimator(Estimator):
    """EKF2; PX4 SIH needs 4.6 s to be ready."""

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

    def flags(self, now_s: float, *, at_rest: bool) -> int:
        """Return ESTIMATOR_STATUS.flags."""
        if self.gps_lost_at_s is not None and not self.ready(now_s):
            return FLAGS_LOST
        if now_s < 0.5 * self.boot_s:
            return FLAGS_BOOT
        if now_s < 0.75 * self.boot_s:
            return FLAGS_ALIGNED
        return (FLAGS_READY if at_rest else FLAGS_MOVING) | (GLITCH if self.glitching else 0)

    def reset_counter(self, now_s: float) -> int:
        """Return ODOMETRY.reset_counter."""
        count = max(n for share, n in _RESETS_AT_BOOT if now_s >= share * self.boot_s)
        return (count + self.extra_resets) % 256

    def drift_m(self, now_s: float, dt_s: float) -> Vector:
        """Return by how much the estimate runs away in ``dt_s``, once GPS is lost."""
        lost = self.gps_lost_at_s is not None and not self.ready(now_s)
        return (RUNAWAY_MPS * dt_s, 0.0, 0.0) if lost else ZERO
