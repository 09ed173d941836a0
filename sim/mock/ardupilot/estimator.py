"""The life cycle of ArduPilot's estimator (EKF3), A20.

The recorded boot takes 41.6 s; a shorter one is the same story told faster. After a loss of GPS
nothing is compressed: those delays are the vehicle's own.
"""

from companion.world.frames import GeoPoint
from sim.mock.dynamics import ZERO, Vector
from sim.mock.estimator import Estimator

RECORDED_BOOT_S = 41.6
"""From power-up to "EKF3 IMU0 is using GPS"."""

INITIALISED_S = 2.4
EKF_S = 3.4
EKF_RUNNING_S = 5.4
ALIGNED_S = 5.9
FIX_S = 9.8
ORIGIN_S = 20.0
HEALTHY_S = 22.6
PREARM_S = 23.6
"""When things happen in the recorded boot."""

GLITCH = 32768
FLAGS_UNINITIALISED = 0x400
FLAGS_STARTED = 0x000
FLAGS_ALIGNED = 0x0A7
FLAGS_READY = 0x33F
FLAGS_DEAD_RECKONING = 0x025

DEAD_RECKONING_S = 7.2
STOPPED_AIDING_S = 15.2
"""GPS lost for so long: not good enough to fly on, and LOCAL_POSITION_NED ends (measured)."""
RUNAWAY_MPS = 0.2
"""How fast dead reckoning drifts off; recorded 2 m in 10 s."""


class CopterEstimator(Estimator):
    """EKF3."""

    def at(self, recorded_s: float) -> float:
        """Return when something happens that happens at ``recorded_s`` of the recorded boot."""
        return recorded_s * self.boot_s / RECORDED_BOOT_S

    def attitude_known(self, now_s: float) -> bool:
        """Whether ATTITUDE is sent; nothing but HEARTBEAT is before."""
        return now_s >= self.at(INITIALISED_S)

    def local_known(self, now_s: float) -> bool:
        """Whether LOCAL_POSITION_NED is sent: only while the estimator uses GPS (A18)."""
        if not self._using_gps(now_s):
            return False
        lost = self.gps_lost_at_s
        return lost is None or now_s - lost < STOPPED_AIDING_S

    def global_known(self, now_s: float) -> bool:
        """Whether GLOBAL_POSITION_INT holds a position; before it is sent with zeros."""
        return now_s >= self.at(FIX_S)

    def origin_known(self, now_s: float) -> bool:
        """Whether origin and home are set."""
        return now_s >= self.at(ORIGIN_S) - 1e-9

    def ready(self, now_s: float) -> bool:
        """Whether position and velocity are good enough to fly on."""
        if not self._using_gps(now_s):
            return False
        lost = self.gps_lost_at_s
        return lost is None or now_s - lost < DEAD_RECKONING_S

    def running(self, now_s: float) -> bool:
        """Whether EKF_STATUS_REPORT is sent."""
        return now_s >= self.at(EKF_S)

    def healthy(self, now_s: float) -> bool:
        """Whether attitude and heading count as healthy."""
        return now_s >= self.at(HEALTHY_S)

    def from_truth(self, true_m: Vector) -> GeoPoint:
        """Return where a true position lies on earth, whatever the estimator believes."""
        return self._at(true_m)

    def flags(self, now_s: float) -> int:
        """Return EKF_STATUS_REPORT.flags."""
        if now_s < self.at(EKF_RUNNING_S):
            return FLAGS_UNINITIALISED
        if now_s < self.at(ALIGNED_S):
            return FLAGS_STARTED
        if not self.local_known(now_s):
            return FLAGS_ALIGNED
        flags = FLAGS_READY if self.ready(now_s) else FLAGS_DEAD_RECKONING
        return flags | (GLITCH if self.glitching else 0)

    def drift_m(self, now_s: float, dt_s: float) -> Vector:
        """Return by how much the estimate runs away in ``dt_s``, once GPS is lost."""
        lost = self.gps_lost_at_s is not None and not self.ready(now_s)
        return (RUNAWAY_MPS * dt_s, 0.0, 0.0) if lost else ZERO

    def _using_gps(self, now_s: float) -> bool:
        return now_s >= self.boot_s - 1e-9
