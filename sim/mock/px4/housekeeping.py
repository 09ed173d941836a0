"""Messages about everything but the flight itself: sensors, battery, time, versions.

Values that PX4 SIH keeps constant (temperatures, sensor masks, accuracies) are those of the
recorded flights.
"""

import math
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim.mock import telemetry as common
from sim.mock.dynamics import GRAVITY_MPS2
from sim.mock.estimator import subtract
from sim.mock.packet import layout
from sim.mock.px4.commander import Px4
from sim.mock.px4.telemetry import quaternion
from sim.mock.telemetry import NAN, boot_ms, boot_us, geodetic_e7, heading_cdeg, stick_pulses

PREARM_CHECK = 0x10000000
GPS_SENSOR = 0x20
RC_SENSOR = 0x10000


def sys_status(px4: Px4) -> Any:
    """SYS_STATUS: sensors, the PREARM_CHECK bit and the battery."""
    present, enabled, health = 0, 0, 0x0321C83F
    if px4.estimator.global_known(px4.now_s):
        present, enabled, health = 0x0300C00F, 0x0301C00F, 0x0320883F
    if px4.estimator.ready(px4.now_s):
        present, enabled, health = present | GPS_SENSOR, enabled | GPS_SENSOR, 0x0320C83F
    if px4.pilot_present():
        present, health = present | RC_SENSOR, health | RC_SENSOR
    if px4.armed or px4.can_arm():
        health |= PREARM_CHECK
    battery = px4.battery
    return layout(mavlink.MAVLink_sys_status_message)(
        present,
        enabled,
        health,
        187,
        round(battery.voltage_v * 1e3),
        -1,
        math.ceil(battery.fraction * 100.0),
        *(0,) * 6,
        0,
        0,
        1,
    )


def gps_raw(px4: Px4) -> Any:
    """GPS_RAW_INT."""
    lost = px4.estimator.gps_lost_at_s is not None
    point = px4.estimator.gps(px4.body.position_m)
    vn, ve, _ = px4.body.velocity_mps
    latitude_e7, longitude_e7, altitude_mm = geodetic_e7(point)
    return layout(mavlink.MAVLink_gps_raw_int_message)(
        boot_us(px4),
        0 if lost else 3,
        latitude_e7,
        longitude_e7,
        altitude_mm,
        70,
        110,
        round(math.hypot(vn, ve) * 100.0),
        heading_cdeg(math.atan2(ve, vn)),
        0 if lost else 10,
        altitude_mm,
        900,
        1780,
        400,
        0,
        0,
    )


def battery_status(px4: Px4) -> Any:
    """BATTERY_STATUS."""
    battery = px4.battery
    voltages = (round(battery.voltage_v * 1e3),) + (65535,) * 9
    remaining = math.ceil(battery.fraction * 100.0)
    return layout(mavlink.MAVLink_battery_status_message)(
        0, 1, 1, 32767, voltages, -1, 0, -1, remaining, 0, 1 if battery.fraction > 0.15 else 2
    )


def vfr_hud(px4: Px4) -> Any:
    """VFR_HUD."""
    return common.vfr_hud(px4, NAN, 0 if px4.landed else 50)


def altitude(px4: Px4) -> Any:
    """ALTITUDE; NaN where nothing is known yet."""
    amsl = px4.estimator.altitude_m(px4.body.position_m)
    if px4.home_true_m is None:
        return layout(mavlink.MAVLink_altitude_message)(boot_us(px4), amsl, NAN, NAN, NAN, NAN, NAN)
    local = -px4.estimator.to_local(px4.body.position_m)[2]
    relative = -subtract(px4.body.position_m, px4.home_true_m)[2]
    return layout(mavlink.MAVLink_altitude_message)(
        boot_us(px4), amsl, amsl, local, relative, NAN, NAN
    )


def attitude_target(px4: Px4) -> Any:
    """ATTITUDE_TARGET, where anything is controlled."""
    if not px4.controls:
        return None
    thrust = 0.0 if px4.landed else 0.5
    return layout(mavlink.MAVLink_attitude_target_message)(
        boot_ms(px4),
        0,
        quaternion(px4),
        0.0,
        0.0,
        px4.flight.demand.yaw_rate_radps,
        thrust,
    )


def highres_imu(px4: Px4) -> Any:
    """HIGHRES_IMU, level and without noise."""
    an, ae, ad = px4.body.acceleration_mps2
    pressure = 955.78 - 0.11 * -px4.body.position_m[2]
    return layout(mavlink.MAVLink_highres_imu_message)(
        boot_us(px4), an, ae, ad - GRAVITY_MPS2, 0.0, 0.0, px4.body.yaw_rate_radps,
        0.213, 0.019, 0.428, pressure, 0.0, 489.4 - px4.body.position_m[2], 15.0, 63,
    )  # fmt: skip


def servo_output(px4: Px4) -> Any:
    """SERVO_OUTPUT_RAW: 900 disarmed, 1100 idling, 1500 in the air."""
    if not px4.controls:
        return None
    pulse = 900 if not px4.armed else 1100 if px4.landed else 1500
    return layout(mavlink.MAVLink_servo_output_raw_message)(
        boot_us(px4), 0, *(pulse,) * 4, *(900,) * 12
    )


def scaled_pressure(px4: Px4) -> Any:
    """SCALED_PRESSURE."""
    pressure = 955.78 + 0.11 * px4.body.position_m[2]
    return layout(mavlink.MAVLink_scaled_pressure_message)(boot_ms(px4), pressure, 0.0, 1182)


def distance_sensor(px4: Px4) -> Any:
    """DISTANCE_SENSOR, looking down."""
    height_cm = round(max(0.0, -px4.body.position_m[2]) * 100.0)
    return layout(mavlink.MAVLink_distance_sensor_message)(
        boot_ms(px4),
        0,
        10000,
        min(height_cm, 10000),
        0,
        0,
        25,
        0,
        0.0,
        0.0,
        (0.0,) * 4,
        1,
    )


def vibration(px4: Px4) -> Any:
    """VIBRATION."""
    return layout(mavlink.MAVLink_vibration_message)(boot_us(px4), 0.0, 0.01, 0.1, 0, 0, 0)


def mission_current(px4: Px4) -> Any:
    """MISSION_CURRENT: none is loaded."""
    return layout(mavlink.MAVLink_mission_current_message)(0, 65535, 1, 2)


def rc_channels(px4: Px4) -> Any:
    """RC_CHANNELS, only with a pilot."""
    if not px4.pilot_present():
        return None
    return layout(mavlink.MAVLink_rc_channels_message)(
        boot_ms(px4), 8, *stick_pulses(px4.pilot.sticks), *(1500,) * 4, *(65535,) * 10, 100
    )


def autopilot_version(px4: Px4) -> Any:
    """AUTOPILOT_VERSION: PX4 1.18.0 beta as recorded."""
    git_hash = (0, 0, 0, 128, 229, 244, 196, 131)
    return mavlink.MAVLink_autopilot_version_message(
        0xE8FF, 0x01120080, 0x01120080, 0x06122CFF, 1, git_hash, git_hash, (0,) * 8, 0, 0,
        0x4954414C44494E4F,
    )  # fmt: skip
