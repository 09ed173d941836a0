"""What ArduCopter says while it boots: texts at the recorded times, told faster if need be."""

from sim.mock.ardupilot.estimator import CopterEstimator
from sim.mock.autopilot import INFO

_IMUS = ("IMU0", "IMU1")
_STORY: tuple[tuple[float, str], ...] = (
    (1.93, "Barometer 1 calibration complete"),
    (1.93, "Barometer 2 calibration complete"),
    (2.45, "ArduPilot Ready"),
    (2.45, "AHRS: DCM active"),
    (2.75, "RC7: SaveWaypoint LOW"),
    *((4.46, f"EKF3 {imu} initialised") for imu in _IMUS),
    (4.46, "AHRS: EKF3 active"),
    *((5.80, f"EKF3 {imu} tilt alignment complete") for imu in _IMUS),
    *((5.90, f"EKF3 {imu} MAG0 initial yaw alignment complete") for imu in _IMUS),
    (9.81, "GPS 1: probing for u-blox at 230400 baud"),
    (9.83, "GPS 1: detected u-blox"),
    (20.03, "EKF3 IMU0 origin set"),
    (20.06, "Field Elevation Set: {altitude:.0f}m"),
    (20.22, "EKF3 IMU1 origin set"),
    *((41.6, f"EKF3 {imu} is using GPS") for imu in _IMUS),
)
USING_GPS = tuple(f"EKF3 {imu} is using GPS" for imu in _IMUS)
STOPPED_AIDING = tuple(f"EKF3 {imu} stopped aiding" for imu in _IMUS)
IN_FLIGHT = tuple(f"EKF3 {imu} MAG0 in-flight yaw alignment complete" for imu in _IMUS)
IN_FLIGHT_M = 3.0
"""The height at which the compass is aligned anew, once per flight."""


class BootStory:
    """Tells what is due, once."""

    def __init__(self, estimator: CopterEstimator) -> None:
        self._estimator = estimator
        self._told = 0

    def take_due(self, now_s: float) -> list[tuple[int, str]]:
        """Return (severity, text) of what has happened since the last call."""
        due = []
        while self._told < len(_STORY) and now_s >= self._estimator.at(_STORY[self._told][0]):
            text = _STORY[self._told][1].format(altitude=self._estimator.origin().altitude_m)
            due.append((INFO, text))
            self._told += 1
        return due
