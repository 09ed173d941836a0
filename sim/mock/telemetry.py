"""What the PX4 personality sends: one builder per message, one table of rates per link.

Values that PX4 SIH keeps constant (covariances, temperatures, sensor masks) are those of the
recorded flights.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim.mock.dynamics import GRAVITY_MPS2
from sim.mock.estimator import subtract
from sim.mock.modes import Mode
from sim.mock.px4 import Px4

NAN = math.nan
IDENTITY = (1.0, 0.0, 0.0, 0.0)
LOCAL_NED = 1
PREARM_CHECK = 0x10000000
GPS_SENSOR = 0x20
RC_SENSOR = 0x10000
ESTIMATOR_AUTOPILOT = 8

Builder = Callable[[Px4], Any]
"""Returns a message, or ``None`` while there is nothing to say."""


def _ms(px4: Px4) -> int:
    return round(px4.now_s * 1e3)


def _us(px4: Px4) -> int:
    return round(px4.now_s * 1e6)


def _e7(angle_deg: float) -> int:
    return round(angle_deg * 1e7)


def quaternion(px4: Px4) -> tuple[float, float, float, float]:
    """Return the attitude as w, x, y, z."""
    half_roll, half_pitch = px4.body.roll_rad / 2.0, px4.body.pitch_rad / 2.0
    half_yaw = px4.body.yaw_rad / 2.0
    cr, sr = math.cos(half_roll), math.sin(half_roll)
    cp, sp = math.cos(half_pitch), math.sin(half_pitch)
    cy, sy = math.cos(half_yaw), math.sin(half_yaw)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def heartbeat(px4: Px4) -> Any:
    """HEARTBEAT: type, mode, armed, system status (P16)."""
    if not px4.estimator.attitude_known(px4.now_s):
        return None
    base_mode = px4.mode.base_mode(armed=px4.armed, offboard_seen=px4.offboard_seen)
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_QUADROTOR,
        mavlink.MAV_AUTOPILOT_PX4,
        base_mode,
        px4.mode.custom_mode,
        px4.system_status,
        3,
    )


def attitude(px4: Px4) -> Any:
    """ATTITUDE."""
    if not px4.estimator.attitude_known(px4.now_s):
        return None
    body = px4.body
    return mavlink.MAVLink_attitude_message(
        _ms(px4), body.roll_rad, body.pitch_rad, body.yaw_rad, 0.0, 0.0, body.yaw_rate_radps
    )


def attitude_quaternion(px4: Px4) -> Any:
    """ATTITUDE_QUATERNION."""
    if not px4.estimator.attitude_known(px4.now_s):
        return None
    return mavlink.MAVLink_attitude_quaternion_message(
        _ms(px4), *quaternion(px4), 0.0, 0.0, px4.body.yaw_rate_radps, IDENTITY
    )


def local_position(px4: Px4) -> Any:
    """LOCAL_POSITION_NED; keeps coming even when the estimate is lost."""
    if not px4.estimator.local_known(px4.now_s):
        return None
    return mavlink.MAVLink_local_position_ned_message(
        _ms(px4), *px4.local_position_m(), *px4.body.velocity_mps
    )


def global_position(px4: Px4) -> Any:
    """GLOBAL_POSITION_INT, absent until valid."""
    if not px4.estimator.global_known(px4.now_s) or px4.home_true_m is None:
        return None
    point = px4.estimator.geodetic(px4.noisy_true_m())
    home = px4.estimator.geodetic(px4.home_true_m)
    vn, ve, vd = px4.body.velocity_mps
    return mavlink.MAVLink_global_position_int_message(
        _ms(px4),
        _e7(point.latitude_deg),
        _e7(point.longitude_deg),
        round(point.altitude_m * 1e3),
        round((point.altitude_m - home.altitude_m) * 1e3),
        round(vn * 100.0),
        round(ve * 100.0),
        round(vd * 100.0),
        round(math.degrees(px4.body.yaw_rad) % 360.0 * 100.0) % 36000,
    )


def odometry(px4: Px4) -> Any:
    """ODOMETRY: frames LOCAL_NED both, and the only sight of estimator resets (P20)."""
    if not px4.estimator.local_known(px4.now_s):
        return None
    return mavlink.MAVLink_odometry_message(
        _us(px4),
        LOCAL_NED,
        LOCAL_NED,
        *px4.local_position_m(),
        quaternion(px4),
        *px4.body.velocity_mps,
        0.0,
        0.0,
        px4.body.yaw_rate_radps,
        (0.01,) + (0.0,) * 20,
        (0.01,) + (0.0,) * 20,
        px4.estimator.reset_counter(px4.now_s),
        ESTIMATOR_AUTOPILOT,
        0,
    )


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
    return mavlink.MAVLink_sys_status_message(
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


def extended_sys_state(px4: Px4) -> Any:
    """EXTENDED_SYS_STATE: landed or not."""
    return mavlink.MAVLink_extended_sys_state_message(0, px4.landed_state)


def gps_raw(px4: Px4) -> Any:
    """GPS_RAW_INT."""
    lost = px4.estimator.gps_lost_at_s is not None
    point = px4.estimator.gps(px4.body.position_m)
    vn, ve, _ = px4.body.velocity_mps
    altitude_mm = round(point.altitude_m * 1e3)
    return mavlink.MAVLink_gps_raw_int_message(
        _us(px4),
        0 if lost else 3,
        _e7(point.latitude_deg),
        _e7(point.longitude_deg),
        altitude_mm,
        70,
        110,
        round(math.hypot(vn, ve) * 100.0),
        round(math.degrees(math.atan2(ve, vn)) % 360.0 * 100.0) % 36000,
        0 if lost else 10,
        altitude_mm,
        900,
        1780,
        400,
        0,
        0,
    )


def estimator_status(px4: Px4) -> Any:
    """ESTIMATOR_STATUS: the flags say whether the position can be trusted."""
    if not px4.estimator.attitude_known(px4.now_s):
        return None
    flags = px4.estimator.flags(px4.now_s, armed=px4.armed)
    return mavlink.MAVLink_estimator_status_message(
        _us(px4), flags, 0.01, 0.01, 0.01, 0.01, 0.01, NAN, 0.2, 0.2
    )


def gps_global_origin(px4: Px4) -> Any:
    """GPS_GLOBAL_ORIGIN; sent when it changes and when asked (P19)."""
    if not px4.estimator.attitude_known(px4.now_s):
        return None
    point = px4.estimator.origin()
    return mavlink.MAVLink_gps_global_origin_message(
        _e7(point.latitude_deg), _e7(point.longitude_deg), round(point.altitude_m * 1e3), _us(px4)
    )


def home_position(px4: Px4) -> Any:
    """HOME_POSITION: set at power-up and again at arming."""
    if px4.home_true_m is None:
        return None
    point = px4.estimator.geodetic(px4.home_true_m)
    return mavlink.MAVLink_home_position_message(
        _e7(point.latitude_deg),
        _e7(point.longitude_deg),
        round(point.altitude_m * 1e3),
        *px4.estimator.to_local(px4.home_true_m),
        IDENTITY,
        0.0,
        0.0,
        0.0,
        _us(px4),
    )


def battery_status(px4: Px4) -> Any:
    """BATTERY_STATUS."""
    battery = px4.battery
    voltages = (round(battery.voltage_v * 1e3),) + (65535,) * 9
    remaining = math.ceil(battery.fraction * 100.0)
    return mavlink.MAVLink_battery_status_message(
        0, 1, 1, 32767, voltages, -1, 0, -1, remaining, 0, 1 if battery.fraction > 0.15 else 2
    )


def system_time(px4: Px4) -> Any:
    """SYSTEM_TIME; the calendar is that of the recorded flights, so that runs repeat."""
    return mavlink.MAVLink_system_time_message(1_795_325_562_000_000 + _us(px4), _ms(px4))


def timesync(px4: Px4) -> Any:
    """TIMESYNC as a question; ``channel`` answers those of others."""
    return mavlink.MAVLink_timesync_message(0, round(px4.now_s * 1e9))


def position_target_local(px4: Px4) -> Any:
    """POSITION_TARGET_LOCAL_NED: mask 7 for a velocity, 0 for a position, 63 when idle."""
    demand = px4.flight.demand
    if px4.landed:
        return mavlink.MAVLink_position_target_local_ned_message(
            _ms(px4), LOCAL_NED, 63, *(NAN,) * 6, 0.0, 0.0, 100.0, px4.body.yaw_rad, 0.0
        )
    setpoint = px4.setpoint if px4.mode is Mode.OFFBOARD else None
    position, mask = (NAN, NAN, NAN), 7
    if setpoint is not None and any(map(math.isfinite, setpoint.position_m)):
        position, mask = setpoint.position_m, 0
    elif demand.position_m is not None:
        position, mask = px4.estimator.to_local(demand.position_m), 0
    return mavlink.MAVLink_position_target_local_ned_message(
        _ms(px4),
        LOCAL_NED,
        mask,
        *position,
        *demand.velocity_mps,
        *px4.body.acceleration_mps2,
        px4.body.yaw_rad,
        demand.yaw_rate_radps,
    )


def position_target_global(px4: Px4) -> Any:
    """POSITION_TARGET_GLOBAL_INT, in the modes that fly by themselves."""
    target = px4.flight.demand.position_m
    if px4.landed or target is None or not px4.mode.is_auto:
        return None
    point = px4.estimator.geodetic(target)
    return mavlink.MAVLink_position_target_global_int_message(
        _ms(px4),
        mavlink.MAV_FRAME_GLOBAL_INT,
        0,
        _e7(point.latitude_deg),
        _e7(point.longitude_deg),
        point.altitude_m,
        *px4.flight.demand.velocity_mps,
        *px4.body.acceleration_mps2,
        px4.body.yaw_rad,
        0.0,
    )


def vfr_hud(px4: Px4) -> Any:
    """VFR_HUD."""
    vn, ve, vd = px4.body.velocity_mps
    point = px4.estimator.geodetic(px4.body.position_m)
    return mavlink.MAVLink_vfr_hud_message(
        NAN,
        math.hypot(vn, ve),
        round(math.degrees(px4.body.yaw_rad)) % 360,
        0 if px4.landed else 50,
        point.altitude_m,
        -vd,
    )


def altitude(px4: Px4) -> Any:
    """ALTITUDE; NaN where nothing is known yet."""
    amsl = px4.estimator.geodetic(px4.body.position_m).altitude_m
    if px4.home_true_m is None:
        return mavlink.MAVLink_altitude_message(_us(px4), amsl, NAN, NAN, NAN, NAN, NAN)
    local = -px4.estimator.to_local(px4.body.position_m)[2]
    relative = -subtract(px4.body.position_m, px4.home_true_m)[2]
    return mavlink.MAVLink_altitude_message(_us(px4), amsl, amsl, local, relative, NAN, NAN)


def attitude_target(px4: Px4) -> Any:
    """ATTITUDE_TARGET."""
    thrust = 0.0 if px4.landed else 0.5
    return mavlink.MAVLink_attitude_target_message(
        _ms(px4), 0, quaternion(px4), 0.0, 0.0, px4.flight.demand.yaw_rate_radps, thrust
    )


def highres_imu(px4: Px4) -> Any:
    """HIGHRES_IMU, level and without noise."""
    an, ae, ad = px4.body.acceleration_mps2
    pressure = 955.78 - 0.11 * -px4.body.position_m[2]
    return mavlink.MAVLink_highres_imu_message(
        _us(px4), an, ae, ad - GRAVITY_MPS2, 0.0, 0.0, px4.body.yaw_rate_radps,
        0.213, 0.019, 0.428, pressure, 0.0, 489.4 - px4.body.position_m[2], 15.0, 63,
    )  # fmt: skip


def servo_output(px4: Px4) -> Any:
    """SERVO_OUTPUT_RAW: 900 disarmed, 1100 idling, 1500 in the air."""
    pulse = 900 if not px4.armed else 1100 if px4.landed else 1500
    return mavlink.MAVLink_servo_output_raw_message(_us(px4), 0, *(pulse,) * 4, *(900,) * 12)


def scaled_pressure(px4: Px4) -> Any:
    """SCALED_PRESSURE."""
    pressure = 955.78 + 0.11 * px4.body.position_m[2]
    return mavlink.MAVLink_scaled_pressure_message(_ms(px4), pressure, 0.0, 1182)


def vibration(px4: Px4) -> Any:
    """VIBRATION."""
    return mavlink.MAVLink_vibration_message(_us(px4), 0.0, 0.01, 0.1, 0, 0, 0)


def mission_current(px4: Px4) -> Any:
    """MISSION_CURRENT: none is loaded."""
    return mavlink.MAVLink_mission_current_message(0, 65535, 1, 2)


def rc_channels(px4: Px4) -> Any:
    """RC_CHANNELS, only with a pilot."""
    if not px4.pilot_present():
        return None
    sticks = px4.pilot.sticks
    axes = (sticks.right, sticks.forward, sticks.up, sticks.turn)
    pulses = tuple(round(1500 + 500 * axis) for axis in axes)
    return mavlink.MAVLink_rc_channels_message(
        _ms(px4), 8, *pulses, *(1500,) * 4, *(65535,) * 10, 100
    )


def autopilot_version(px4: Px4) -> Any:
    """AUTOPILOT_VERSION: PX4 1.18.0 beta as recorded."""
    git_hash = (0, 0, 0, 128, 229, 244, 196, 131)
    return mavlink.MAVLink_autopilot_version_message(
        0xE8FF, 0x01120080, 0x01120080, 0x06122CFF, 1, git_hash, git_hash, (0,) * 8, 0, 0,
        0x4954414C44494E4F,
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Stream:
    """A message and its default rates; 0 means on request or on change only."""

    build: Builder
    onboard_hz: float
    ground_hz: float


STREAMS: dict[int, Stream] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: Stream(heartbeat, 1.0, 1.0),
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: Stream(sys_status, 5.0, 1.0),
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: Stream(system_time, 1.0, 1.0),
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: Stream(gps_raw, 8.0, 5.0),
    mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE: Stream(scaled_pressure, 1.0, 1.0),
    mavlink.MAVLINK_MSG_ID_ATTITUDE: Stream(attitude, 100.0, 50.0),
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: Stream(attitude_quaternion, 50.0, 50.0),
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: Stream(local_position, 30.0, 50.0),
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: Stream(global_position, 50.0, 50.0),
    mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: Stream(servo_output, 10.0, 50.0),
    mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: Stream(mission_current, 1.0, 1.0),
    mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: Stream(gps_global_origin, 0.0, 0.0),
    mavlink.MAVLINK_MSG_ID_RC_CHANNELS: Stream(rc_channels, 20.0, 5.0),
    mavlink.MAVLINK_MSG_ID_VFR_HUD: Stream(vfr_hud, 10.0, 4.0),
    mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET: Stream(attitude_target, 10.0, 2.0),
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: Stream(position_target_local, 10.0, 50.0),
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT: Stream(position_target_global, 10.0, 1.5),
    mavlink.MAVLINK_MSG_ID_HIGHRES_IMU: Stream(highres_imu, 50.0, 0.0),
    mavlink.MAVLINK_MSG_ID_TIMESYNC: Stream(timesync, 10.0, 0.0),
    mavlink.MAVLINK_MSG_ID_ALTITUDE: Stream(altitude, 10.0, 1.0),
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: Stream(battery_status, 0.5, 0.5),
    mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: Stream(autopilot_version, 0.0, 0.0),
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: Stream(estimator_status, 1.0, 0.5),
    mavlink.MAVLINK_MSG_ID_VIBRATION: Stream(vibration, 0.5, 0.1),
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: Stream(home_position, 0.5, 0.5),
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: Stream(extended_sys_state, 5.0, 1.0),
    mavlink.MAVLINK_MSG_ID_ODOMETRY: Stream(odometry, 30.0, 0.0),
}
