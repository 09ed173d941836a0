"""Which messages ArduCopter can send, and which of its streams they belong to.

Nothing but HEARTBEAT is sent before somebody asks (A21). Groups and their members are those
counted on ArduCopter 4.6.3 after REQUEST_DATA_STREAM.
"""

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim.mock import telemetry as common
from sim.mock.ardupilot import housekeeping, telemetry
from sim.mock.streams import Builder

ALL = mavlink.MAV_DATA_STREAM_ALL

GROUPS: dict[int, dict[int, Builder]] = {
    mavlink.MAV_DATA_STREAM_RAW_SENSORS: {
        mavlink.MAVLINK_MSG_ID_RAW_IMU: housekeeping.raw_imu,
        mavlink.MAVLINK_MSG_ID_SCALED_IMU2: housekeeping.scaled_imu2,
        mavlink.MAVLINK_MSG_ID_SCALED_IMU3: housekeeping.scaled_imu3,
        mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE: housekeeping.scaled_pressure,
        mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE2: housekeeping.scaled_pressure2,
    },
    mavlink.MAV_DATA_STREAM_EXTENDED_STATUS: {
        mavlink.MAVLINK_MSG_ID_SYS_STATUS: housekeeping.sys_status,
        mavlink.MAVLINK_MSG_ID_POWER_STATUS: housekeeping.power_status,
        mavlink.MAVLINK_MSG_ID_MEMINFO: housekeeping.meminfo,
        mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: housekeeping.mission_current,
        mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: housekeeping.gps_raw,
        mavlink.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT: housekeeping.nav_controller_output,
        mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT: telemetry.position_target_global,
    },
    mavlink.MAV_DATA_STREAM_RC_CHANNELS: {
        mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: housekeeping.servo_output,
        mavlink.MAVLINK_MSG_ID_RC_CHANNELS: housekeeping.rc_channels,
    },
    mavlink.MAV_DATA_STREAM_POSITION: {
        mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: telemetry.global_position,
        mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: common.local_position,
    },
    mavlink.MAV_DATA_STREAM_EXTRA1: {
        mavlink.MAVLINK_MSG_ID_ATTITUDE: common.attitude,
        mavlink.MAVLINK_MSG_ID_SIMSTATE: housekeeping.simstate,
        mavlink.MAVLINK_MSG_ID_AHRS2: telemetry.ahrs2,
    },
    mavlink.MAV_DATA_STREAM_EXTRA2: {
        mavlink.MAVLINK_MSG_ID_VFR_HUD: telemetry.vfr_hud,
    },
    mavlink.MAV_DATA_STREAM_EXTRA3: {
        mavlink.MAVLINK_MSG_ID_AHRS: housekeeping.ahrs,
        mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: housekeeping.system_time,
        mavlink.MAVLINK_MSG_ID_WIND: housekeeping.wind,
        mavlink.MAVLINK_MSG_ID_TERRAIN_REPORT: housekeeping.terrain_report,
        mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: housekeeping.battery_status,
        mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: telemetry.ekf_status,
        mavlink.MAVLINK_MSG_ID_VIBRATION: housekeeping.vibration,
        mavlink.MAVLINK_MSG_ID_ESC_TELEMETRY_1_TO_4: housekeeping.esc_telemetry,
    },
}
SINGLE: dict[int, Builder] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: telemetry.heartbeat,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: telemetry.extended_sys_state,
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: telemetry.position_target_local,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: telemetry.home_position,
    mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: telemetry.gps_global_origin,
    mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: housekeeping.autopilot_version,
}
"""Messages that belong to no stream: only SET_MESSAGE_INTERVAL and REQUEST_MESSAGE give them."""

BUILDERS: dict[int, Builder] = SINGLE | {
    id_: build for group in GROUPS.values() for id_, build in group.items()
}


def members(stream: int) -> list[int]:
    """Return the messages of a MAV_DATA_STREAM; ALL is every stream, not every message."""
    if stream == ALL:
        return [id_ for group in GROUPS.values() for id_ in group]
    return list(GROUPS.get(stream, ()))
