"""ArduCopter's messages about everything but the flight: sensors, battery, versions.

Values that its simulator keeps constant are those of the recorded flights.
"""

import math
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim.mock import telemetry as common
from sim.mock.ardupilot.copter import ArduCopter
from sim.mock.ardupilot.modes import Mode
from sim.mock.dynamics import GRAVITY_MPS2
from sim.mock.packet import layout
from sim.mock.telemetry import boot_ms, boot_us, geodetic_e7, heading_cdeg, stick_pulses

GPS_SENSOR = 0x20
POSITION_CONTROL = 0x6000
AHRS_HEALTHY = 0x200000
LOGGING = 0x1000000
PREARM_CHECK = 0x10000000
GPS_PERIOD_S = 0.2
VOLTAGE_MV = 12600
"""ArduPilot's simulated battery keeps its voltage."""


def sys_status(copter: ArduCopter) -> Any:
    """SYS_STATUS: sensors, the PREARM_CHECK bit and the battery."""
    if not copter.initialised:
        return None
    present, enabled, health = 0x5371FC0F, 0x52419C0F, 0x47519C0F
    if copter.estimator.global_known(copter.now_s):
        present, enabled, health = present | GPS_SENSOR, enabled | GPS_SENSOR, health | GPS_SENSOR
    if copter.estimator.healthy(copter.now_s):
        enabled, health = enabled | AHRS_HEALTHY, health | AHRS_HEALTHY
    if copter.mode.requires_position or copter.mode is Mode.LAND:
        enabled |= POSITION_CONTROL
        health |= POSITION_CONTROL if copter.position_good else 0x2000
    if copter.armed:
        enabled |= LOGGING
    if copter.armed or copter.can_arm():
        health |= PREARM_CHECK
    battery = round(copter.battery.fraction * 100.0)
    return layout(mavlink.MAVLink_sys_status_message)(
        present, enabled, health, 0, VOLTAGE_MV, 0, battery, *(0,) * 6
    )


def gps_raw(copter: ArduCopter) -> Any:
    """GPS_RAW_INT: no receiver, then an RTK fix; 1 (no fix) when it is lost."""
    if not copter.initialised:
        return None
    if not copter.estimator.global_known(copter.now_s):
        return layout(mavlink.MAVLink_gps_raw_int_message)(0, 0, 0, 0, 0, 65535, 65535, 0, 0, 0)
    lost = copter.estimator.gps_lost_at_s is not None
    point = copter.estimator.gps(copter.body.position_m)
    north, east, _ = copter.body.velocity_mps
    stamp_us = round(math.floor(copter.now_s / GPS_PERIOD_S) * GPS_PERIOD_S * 1e6)
    latitude, longitude, altitude_mm = geodetic_e7(point)
    return layout(mavlink.MAVLink_gps_raw_int_message)(
        stamp_us, 1 if lost else 6, latitude, longitude, altitude_mm, 121, 200,
        round(math.hypot(north, east) * 100.0), heading_cdeg(math.atan2(east, north)),
        3 if lost else 10, altitude_mm, 300, 300, 0, 0, 0,
    )  # fmt: skip


def battery_status(copter: ArduCopter) -> Any:
    """BATTERY_STATUS."""
    if not copter.initialised:
        return None
    used_mah = (1.0 - copter.battery.fraction) * copter.parameters.number("BATT_CAPACITY")
    voltages = (VOLTAGE_MV,) + (65535,) * 9
    remaining = round(copter.battery.fraction * 100.0)
    current = 2700 if copter.armed and not copter.landed else 0
    return layout(mavlink.MAVLink_battery_status_message)(
        0, 0, 0, 32767, voltages, current, round(used_mah), round(used_mah * 0.45), remaining, 0, 1
    )


def servo_output(copter: ArduCopter) -> Any:
    """SERVO_OUTPUT_RAW: 1000 disarmed, 1100 idling, 1550 in the air."""
    if not copter.initialised:
        return None
    pulse = 1000 if not copter.armed else 1100 if copter.landed else 1550
    return layout(mavlink.MAVLink_servo_output_raw_message)(
        boot_us(copter), 0, *(pulse,) * 4, *(0,) * 12
    )


def rc_channels(copter: ArduCopter) -> Any:
    """RC_CHANNELS: eight of them; the throttle is down without a pilot, as in SITL."""
    if not copter.initialised:
        return None
    roll, pitch, throttle, yaw = stick_pulses(copter.pilot.sticks)
    throttle = throttle if copter.pilot.radio else 1000
    return layout(mavlink.MAVLink_rc_channels_message)(
        boot_ms(copter), 8, roll, pitch, throttle, yaw, 1800, 1000, 1000, 1800, *(0,) * 10, 255
    )


def _imu(copter: ArduCopter) -> tuple[int, ...]:
    """Return accelerations (mg), rates (mrad/s) and magnetic field, level and without noise."""
    north, east, down = copter.body.acceleration_mps2
    milli_g = (round(value / GRAVITY_MPS2 * 1e3) for value in (north, east, down - GRAVITY_MPS2))
    return (*milli_g, 0, 0, round(copter.body.yaw_rate_radps * 1e3), 224, 80, -528)


def raw_imu(copter: ArduCopter) -> Any:
    """RAW_IMU."""
    if not copter.initialised:
        return None
    return layout(mavlink.MAVLink_raw_imu_message)(boot_us(copter), *_imu(copter), 0, 2900)


def scaled_imu2(copter: ArduCopter) -> Any:
    """SCALED_IMU2."""
    if not copter.initialised:
        return None
    return layout(mavlink.MAVLink_scaled_imu2_message)(boot_ms(copter), *_imu(copter), 2900)


def scaled_imu3(copter: ArduCopter) -> Any:
    """SCALED_IMU3: a compass only."""
    if not copter.initialised:
        return None
    return layout(mavlink.MAVLink_scaled_imu3_message)(
        boot_ms(copter), *(0,) * 6, *_imu(copter)[6:], 0
    )  # fmt: skip


def _pressure_hpa(copter: ArduCopter) -> float:
    return 945.02 + 0.11 * copter.body.position_m[2]


def scaled_pressure(copter: ArduCopter) -> Any:
    """SCALED_PRESSURE."""
    if not copter.initialised:
        return None
    return layout(mavlink.MAVLink_scaled_pressure_message)(
        boot_ms(copter), _pressure_hpa(copter), 0.0, 2563
    )


def scaled_pressure2(copter: ArduCopter) -> Any:
    """SCALED_PRESSURE2."""
    if not copter.initialised:
        return None
    return layout(mavlink.MAVLink_scaled_pressure2_message)(
        boot_ms(copter), _pressure_hpa(copter), 0.0, 2563
    )


def nav_controller_output(copter: ArduCopter) -> Any:
    """NAV_CONTROLLER_OUTPUT."""
    if not copter.initialised:
        return None
    roll, pitch, yaw = map(math.degrees, copter.body.attitude_rad)
    return layout(mavlink.MAVLink_nav_controller_output_message)(
        roll, pitch, round(yaw), 0, 0, 0.0, 0.0, 0.0
    )


def mission_current(copter: ArduCopter) -> Any:
    """MISSION_CURRENT: none is loaded."""
    return layout(mavlink.MAVLink_mission_current_message)(0, 0, 1) if copter.initialised else None


def power_status(copter: ArduCopter) -> Any:
    """POWER_STATUS."""
    return layout(mavlink.MAVLink_power_status_message)(5000, 0, 0) if copter.initialised else None


def meminfo(copter: ArduCopter) -> Any:
    """MEMINFO."""
    return layout(mavlink.MAVLink_meminfo_message)(0, 65535, 524288) if copter.initialised else None


def ahrs(copter: ArduCopter) -> Any:
    """AHRS: drift estimates, all zero."""
    return layout(mavlink.MAVLink_ahrs_message)(*(0.0,) * 7) if copter.initialised else None


def simstate(copter: ArduCopter) -> Any:
    """SIMSTATE: the truth, as ArduPilot's simulator tells it."""
    if not copter.initialised:
        return None
    body = copter.body
    truth = copter.estimator.from_truth(body.position_m)
    north, east, down = body.acceleration_mps2
    return layout(mavlink.MAVLink_simstate_message)(
        *body.attitude_rad, north, east, down - GRAVITY_MPS2,
        0.0, 0.0, body.yaw_rate_radps, *geodetic_e7(truth)[:2],
    )  # fmt: skip


def system_time(copter: ArduCopter) -> Any:
    """SYSTEM_TIME: no calendar before the fix."""
    if not copter.initialised:
        return None
    if copter.estimator.global_known(copter.now_s):
        return common.system_time(copter)
    return layout(mavlink.MAVLink_system_time_message)(0, boot_ms(copter))


def wind(copter: ArduCopter) -> Any:
    """WIND, once the estimator uses GPS: none is estimated."""
    known = copter.estimator.local_known(copter.now_s)
    return layout(mavlink.MAVLink_wind_message)(-180.0, 0.0, 0.0) if known else None


def terrain_report(copter: ArduCopter) -> Any:
    """TERRAIN_REPORT: no terrain is known."""
    if not copter.initialised:
        return None
    latitude, longitude, altitude_m = 0, 0, 0.0
    if copter.estimator.global_known(copter.now_s):
        point = copter.estimator.geodetic(copter.body.position_m)
        latitude, longitude, _ = geodetic_e7(point)
        altitude_m = point.altitude_m
    return layout(mavlink.MAVLink_terrain_report_message)(
        latitude, longitude, 0, 0.0, altitude_m, 504, 0
    )


def vibration(copter: ArduCopter) -> Any:
    """VIBRATION."""
    if not copter.initialised:
        return None
    return layout(mavlink.MAVLink_vibration_message)(boot_us(copter), 0.003, 0.003, 0.003, 0, 0, 0)


def esc_telemetry(copter: ArduCopter) -> Any:
    """ESC_TELEMETRY_1_TO_4: four motors, all well."""
    if not copter.estimator.attitude_known(copter.now_s):
        return None
    count = round(copter.now_s * 10.0) % 65536
    return layout(mavlink.MAVLink_esc_telemetry_1_to_4_message)(
        (32,) * 4, (1679,) * 4, (80,) * 4, (1,) * 4, (0,) * 4, (count,) * 4
    )


def autopilot_version(copter: ArduCopter) -> Any:
    """AUTOPILOT_VERSION: ArduCopter 4.6.3 as recorded; the hash is text, 92b0cd78."""
    return mavlink.MAVLink_autopilot_version_message(
        0xFBEF, 0x040603FF, 0, 0, 0, tuple(b"92b0cd78"), (0,) * 8, (0,) * 8, 0, 0, 0
    )
