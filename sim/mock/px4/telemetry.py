"""PX4's own messages about the flight: mode, estimator, targets. One builder per message.

A builder returns ``None`` while there is nothing to say.

Values that PX4 SIH keeps constant (covariances, temperatures, sensor masks) are those of the
recorded flights.
"""

import math
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim.mock import telemetry as common
from sim.mock.packet import layout
from sim.mock.px4.commander import Px4
from sim.mock.px4.modes import Mode
from sim.mock.telemetry import NAN, boot_ms, boot_us, geodetic_e7

IDENTITY = (1.0, 0.0, 0.0, 0.0)
COVARIANCE = (0.01, *(0.0,) * 20)
LOCAL_NED = 1
ESTIMATOR_AUTOPILOT = 8


def quaternion(px4: Px4) -> tuple[float, float, float, float]:
    """Return the attitude as w, x, y, z."""
    half_roll, half_pitch, half_yaw = (angle / 2.0 for angle in px4.body.attitude_rad)
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


def attitude_quaternion(px4: Px4) -> Any:
    """ATTITUDE_QUATERNION."""
    if not px4.estimator.attitude_known(px4.now_s):
        return None
    return layout(mavlink.MAVLink_attitude_quaternion_message)(
        boot_ms(px4),
        *quaternion(px4),
        0.0,
        0.0,
        px4.body.yaw_rate_radps,
        IDENTITY,
    )


def odometry(px4: Px4) -> Any:
    """ODOMETRY: frames LOCAL_NED both, and the only sight of estimator resets (P20)."""
    if not px4.estimator.local_known(px4.now_s):
        return None
    return layout(mavlink.MAVLink_odometry_message)(
        boot_us(px4),
        LOCAL_NED,
        LOCAL_NED,
        *px4.local_position_m(),
        quaternion(px4),
        *px4.body.velocity_mps,
        0.0,
        0.0,
        px4.body.yaw_rate_radps,
        COVARIANCE,
        COVARIANCE,
        px4.estimator.reset_counter(px4.now_s),
        ESTIMATOR_AUTOPILOT,
        0,
    )


def extended_sys_state(px4: Px4) -> Any:
    """EXTENDED_SYS_STATE: landed or not."""
    return mavlink.MAVLink_extended_sys_state_message(0, px4.landed_state)


def estimator_status(px4: Px4) -> Any:
    """ESTIMATOR_STATUS: the flags say whether the position can be trusted."""
    if not px4.estimator.attitude_known(px4.now_s):
        return None
    flags = px4.estimator.flags(px4.now_s, at_rest=px4.at_rest)
    return mavlink.MAVLink_estimator_status_message(
        boot_us(px4), flags, 0.01, 0.01, 0.01, 0.01, 0.01, NAN, 0.2, 0.2
    )


def gps_global_origin(px4: Px4) -> Any:
    """GPS_GLOBAL_ORIGIN; sent when it changes and when asked (P19)."""
    known = px4.estimator.attitude_known(px4.now_s)
    return common.gps_global_origin(px4) if known else None


def home_position(px4: Px4) -> Any:
    """HOME_POSITION: set at power-up and again at arming."""
    return common.home_position(px4, IDENTITY)


def position_target_local(px4: Px4) -> Any:
    """POSITION_TARGET_LOCAL_NED: mask 7 for a velocity, 0 for a position, 63 when idle."""
    if not px4.controls:
        return None
    demand = px4.flight.demand
    if px4.landed:
        return layout(mavlink.MAVLink_position_target_local_ned_message)(
            boot_ms(px4),
            LOCAL_NED,
            63,
            *(NAN,) * 6,
            0.0,
            0.0,
            100.0,
            px4.body.yaw_rad,
            0.0,
        )
    setpoint = px4.setpoint if px4.mode is Mode.OFFBOARD else None
    position, mask = (NAN, NAN, NAN), 7
    if setpoint is not None and any(map(math.isfinite, setpoint.position_m)):
        position, mask = setpoint.position_m, 0
    elif demand.position_m is not None:
        position, mask = px4.estimator.to_local(demand.position_m), 0
    return layout(mavlink.MAVLink_position_target_local_ned_message)(
        boot_ms(px4),
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
    if not px4.armed or target is None or not px4.mode.is_auto:
        return None
    point = px4.estimator.geodetic(target)
    return layout(mavlink.MAVLink_position_target_global_int_message)(
        boot_ms(px4),
        mavlink.MAV_FRAME_GLOBAL_INT,
        0,
        *geodetic_e7(point)[:2],
        point.altitude_m,
        *px4.flight.demand.velocity_mps,
        *px4.body.acceleration_mps2,
        px4.body.yaw_rad,
        0.0,
    )
