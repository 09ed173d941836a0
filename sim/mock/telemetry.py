"""Messages that both autopilots send alike, and the pieces of those that they do not.

A builder returns ``None`` while there is nothing to say.
"""

import math
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.world.frames import GeoPoint
from sim.mock.autopilot import Autopilot
from sim.mock.packet import layout
from sim.mock.pilot import Sticks

NAN = math.nan
CALENDAR_US = 1_795_325_562_000_000
"""The calendar is that of the recorded flights, so that runs repeat."""


def boot_ms(autopilot: Autopilot) -> int:
    """Return the time since power-up in milliseconds."""
    return round(autopilot.now_s * 1e3)


def boot_us(autopilot: Autopilot) -> int:
    """Return the time since power-up in microseconds."""
    return round(autopilot.now_s * 1e6)


def degrees_e7(angle_deg: float) -> int:
    """Return an angle as MAVLink's degrees times 1e7."""
    return round(angle_deg * 1e7)


def heading_cdeg(angle_rad: float) -> int:
    """Return an angle as a heading of 0 to 35999 centidegrees."""
    return round(math.degrees(angle_rad) % 360.0 * 100.0) % 36000


def geodetic_e7(point: GeoPoint) -> tuple[int, int, int]:
    """Return latitude and longitude in degrees times 1e7 and the altitude in millimetres."""
    return (
        degrees_e7(point.latitude_deg),
        degrees_e7(point.longitude_deg),
        round(point.altitude_m * 1e3),
    )


def attitude(autopilot: Autopilot) -> Any:
    """ATTITUDE."""
    if not autopilot.estimator.attitude_known(autopilot.now_s):
        return None
    body = autopilot.body
    return layout(mavlink.MAVLink_attitude_message)(
        boot_ms(autopilot),
        *body.attitude_rad,
        0.0,
        0.0,
        body.yaw_rate_radps,
    )


def local_position(autopilot: Autopilot) -> Any:
    """LOCAL_POSITION_NED."""
    if not autopilot.estimator.local_known(autopilot.now_s):
        return None
    return layout(mavlink.MAVLink_local_position_ned_message)(
        boot_ms(autopilot),
        *autopilot.local_position_m(),
        *autopilot.body.velocity_mps,
    )


def global_position(autopilot: Autopilot) -> Any:
    """GLOBAL_POSITION_INT, absent until there is a position and a home."""
    if autopilot.home_true_m is None or not autopilot.estimator.global_known(autopilot.now_s):
        return None
    point = autopilot.estimator.geodetic(autopilot.noisy_true_m())
    home_m = autopilot.estimator.altitude_m(autopilot.home_true_m)
    vn, ve, vd = autopilot.body.velocity_mps
    return layout(mavlink.MAVLink_global_position_int_message)(
        boot_ms(autopilot),
        *geodetic_e7(point),
        round((point.altitude_m - home_m) * 1e3),
        round(vn * 100.0),
        round(ve * 100.0),
        round(vd * 100.0),
        heading_cdeg(autopilot.body.yaw_rad),
    )


def gps_global_origin(autopilot: Autopilot) -> Any:
    """GPS_GLOBAL_ORIGIN."""
    return layout(mavlink.MAVLink_gps_global_origin_message)(
        *geodetic_e7(autopilot.estimator.origin()), boot_us(autopilot)
    )


def home_position(autopilot: Autopilot, q: tuple[float, float, float, float]) -> Any:
    """HOME_POSITION with an orientation that means nothing."""
    if autopilot.home_true_m is None:
        return None
    return layout(mavlink.MAVLink_home_position_message)(
        *geodetic_e7(autopilot.estimator.geodetic(autopilot.home_true_m)),
        *autopilot.estimator.to_local(autopilot.home_true_m),
        q,
        0.0,
        0.0,
        0.0,
        boot_us(autopilot),
    )


def system_time(autopilot: Autopilot) -> Any:
    """SYSTEM_TIME."""
    clock_us = CALENDAR_US + boot_us(autopilot)
    return layout(mavlink.MAVLink_system_time_message)(clock_us, boot_ms(autopilot))


def timesync(autopilot: Autopilot) -> Any:
    """TIMESYNC as a question; ``incoming`` answers those of others."""
    return layout(mavlink.MAVLink_timesync_message)(0, round(autopilot.now_s * 1e9))


def vfr_hud(autopilot: Autopilot, airspeed_mps: float, throttle_percent: int) -> Any:
    """VFR_HUD."""
    vn, ve, vd = autopilot.body.velocity_mps
    altitude_m = autopilot.estimator.altitude_m(autopilot.body.position_m)
    heading = round(math.degrees(autopilot.body.yaw_rad)) % 360
    return layout(mavlink.MAVLink_vfr_hud_message)(
        airspeed_mps,
        math.hypot(vn, ve),
        heading,
        throttle_percent,
        altitude_m,
        -vd,
    )


def stick_pulses(sticks: Sticks) -> tuple[int, int, int, int]:
    """Return roll, pitch, throttle and yaw as pulses of 1000 to 2000 us."""
    roll, pitch, throttle, yaw = (
        round(1500 + 500 * axis) for axis in (sticks.right, sticks.forward, sticks.up, sticks.turn)
    )
    return roll, pitch, throttle, yaw
