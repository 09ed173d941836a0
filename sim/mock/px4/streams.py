"""Which messages the PX4 personality sends, and how often on which kind of link.

The rates are those counted on PX4 1.18 SIH, port 14540 (onboard) and 14550 (ground station).
"""

from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim.mock import telemetry as common
from sim.mock.px4 import housekeeping, telemetry, undecodable
from sim.mock.streams import Builder


@dataclass(frozen=True, slots=True)
class Stream:
    """A message and its default rates; 0 means on request or on change only."""

    build: Builder
    onboard_hz: float
    ground_hz: float


STREAMS: dict[int, Stream] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: Stream(telemetry.heartbeat, 1.0, 1.0),
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: Stream(housekeeping.sys_status, 5.0, 1.0),
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: Stream(common.system_time, 1.0, 1.0),
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: Stream(housekeeping.gps_raw, 8.0, 5.0),
    mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE: Stream(housekeeping.scaled_pressure, 1.0, 1.0),
    mavlink.MAVLINK_MSG_ID_ATTITUDE: Stream(common.attitude, 100.0, 50.0),
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: Stream(telemetry.attitude_quaternion, 50.0, 50.0),
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: Stream(common.local_position, 30.0, 50.0),
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: Stream(common.global_position, 50.0, 50.0),
    mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: Stream(housekeeping.servo_output, 10.0, 50.0),
    mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: Stream(housekeeping.mission_current, 1.0, 1.0),
    mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: Stream(telemetry.gps_global_origin, 0.0, 0.0),
    mavlink.MAVLINK_MSG_ID_RC_CHANNELS: Stream(housekeeping.rc_channels, 20.0, 5.0),
    mavlink.MAVLINK_MSG_ID_VFR_HUD: Stream(housekeeping.vfr_hud, 10.0, 4.0),
    mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET: Stream(housekeeping.attitude_target, 10.0, 2.0),
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: Stream(
        telemetry.position_target_local, 10.0, 50.0
    ),
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT: Stream(
        telemetry.position_target_global, 10.0, 1.5
    ),
    mavlink.MAVLINK_MSG_ID_HIGHRES_IMU: Stream(housekeeping.highres_imu, 50.0, 0.0),
    mavlink.MAVLINK_MSG_ID_TIMESYNC: Stream(common.timesync, 10.0, 0.0),
    mavlink.MAVLINK_MSG_ID_ALTITUDE: Stream(housekeeping.altitude, 10.0, 1.0),
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: Stream(housekeeping.battery_status, 0.5, 0.5),
    mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: Stream(housekeeping.autopilot_version, 0.0, 0.0),
    undecodable.PROTOCOL_VERSION.message_id: Stream(undecodable.protocol_version, 0.0, 0.0),
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: Stream(telemetry.estimator_status, 1.0, 0.5),
    mavlink.MAVLINK_MSG_ID_VIBRATION: Stream(housekeeping.vibration, 0.5, 0.1),
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: Stream(telemetry.home_position, 0.5, 0.5),
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: Stream(telemetry.extended_sys_state, 5.0, 1.0),
    mavlink.MAVLINK_MSG_ID_ODOMETRY: Stream(telemetry.odometry, 30.0, 0.0),
    mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR: Stream(housekeeping.distance_sensor, 10.0, 0.5),
    undecodable.ESC_INFO.message_id: Stream(undecodable.esc_info, 10.0, 1.0),
    undecodable.ESC_STATUS.message_id: Stream(undecodable.esc_status, 10.0, 1.0),
    undecodable.CURRENT_MODE.message_id: Stream(undecodable.current_mode, 0.5, 0.5),
}
