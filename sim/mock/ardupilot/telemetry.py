"""ArduCopter's own messages about the flight: mode, estimator, positions, targets.

A builder returns ``None`` while there is nothing to say.
"""

import math
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim.mock import telemetry as common
from sim.mock.ardupilot.copter import ArduCopter
from sim.mock.ardupilot.flight import Guided
from sim.mock.ardupilot.modes import (
    ARMED,
    MODE_CUSTOM,
    MODE_GUIDED,
    MODE_MANUAL_INPUT,
    MODE_STABILIZE,
    Mode,
)
from sim.mock.packet import layout
from sim.mock.telemetry import boot_ms, geodetic_e7, heading_cdeg

LOCAL_NED, GLOBAL = 1, 0
UNKNOWN = (math.nan,) * 4
VTOL_UNDEFINED_BUT_MULTICOPTER = 3
VELOCITY_MASK, POSITION_MASK, RETURN_MASK = 3079, 3576, 65016
"""POSITION_TARGET masks as recorded."""


def heartbeat(copter: ArduCopter) -> Any:
    """HEARTBEAT; the "guided" bit tells whether the position controller runs."""
    bits = MODE_CUSTOM | MODE_MANUAL_INPUT | MODE_STABILIZE
    bits |= ARMED if copter.armed else 0
    bits |= MODE_GUIDED if copter.controls_position else 0
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_QUADROTOR,
        mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA,
        bits,
        copter.mode.value,
        copter.system_status,
        3,
    )


def global_position(copter: ArduCopter) -> Any:
    """GLOBAL_POSITION_INT: zeros before the fix, which are no position."""
    if not copter.initialised:
        return None
    if not copter.estimator.global_known(copter.now_s):
        heading = heading_cdeg(copter.body.yaw_rad)
        return layout(mavlink.MAVLink_global_position_int_message)(
            boot_ms(copter), 0, 0, 0, 0, 0, 0, 0, heading
        )
    if copter.home_true_m is not None:
        return common.global_position(copter)
    point = copter.estimator.geodetic(copter.noisy_true_m())
    return layout(mavlink.MAVLink_global_position_int_message)(
        boot_ms(copter), *geodetic_e7(point), 0, 0, 0, 0, heading_cdeg(copter.body.yaw_rad)
    )


def extended_sys_state(copter: ArduCopter) -> Any:
    """EXTENDED_SYS_STATE: landed or not."""
    if not copter.initialised:
        return None
    return mavlink.MAVLink_extended_sys_state_message(
        VTOL_UNDEFINED_BUT_MULTICOPTER, copter.landed_state
    )


def ekf_status(copter: ArduCopter) -> Any:
    """EKF_STATUS_REPORT: the flags say whether the position can be trusted (A20)."""
    if not copter.estimator.running(copter.now_s):
        return None
    good = copter.position_good
    return mavlink.MAVLink_ekf_status_report_message(
        copter.estimator.flags(copter.now_s),
        0.001 if good else 0.9,
        0.005 if good else 0.9,
        0.002,
        0.03,
        0.0,
    )


def gps_global_origin(copter: ArduCopter) -> Any:
    """GPS_GLOBAL_ORIGIN: sent when it is set, when home is, and when asked."""
    known = copter.estimator.origin_known(copter.now_s)
    return common.gps_global_origin(copter) if known else None


def home_position(copter: ArduCopter) -> Any:
    """HOME_POSITION: set with the origin and again at arming."""
    return common.home_position(copter, UNKNOWN)


def position_target_local(copter: ArduCopter) -> Any:
    """POSITION_TARGET_LOCAL_NED, in GUIDED only; zeros while it takes off (recorded)."""
    if copter.mode is not Mode.GUIDED:
        return None
    flight, position, velocity = copter.flight, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    mask = VELOCITY_MASK if flight.guided is Guided.VELOCITY else POSITION_MASK
    if flight.guided is Guided.VELOCITY:
        velocity = flight.velocity_mps
    elif flight.guided is Guided.POSITION:
        position = copter.estimator.to_local(flight.target_true_m)
    return layout(mavlink.MAVLink_position_target_local_ned_message)(
        boot_ms(copter), LOCAL_NED, mask, *position, *velocity, 0.0, 0.0, 0.0, 0.0, 0.0
    )


def position_target_global(copter: ArduCopter) -> Any:
    """POSITION_TARGET_GLOBAL_INT, in RTL only."""
    if copter.mode is not Mode.RTL:
        return None
    point = copter.estimator.geodetic(copter.flight.target_true_m)
    return layout(mavlink.MAVLink_position_target_global_int_message)(
        boot_ms(copter), GLOBAL, RETURN_MASK, *geodetic_e7(point)[:2], point.altitude_m,
        *(0.0,) * 8,
    )  # fmt: skip


def ahrs2(copter: ArduCopter) -> Any:
    """AHRS2: the second attitude estimate, here the same."""
    if not copter.estimator.running(copter.now_s):
        return None
    body = copter.body
    latitude, longitude, altitude_m = 0, 0, 0.0
    if copter.estimator.global_known(copter.now_s):
        point = copter.estimator.geodetic(body.position_m)
        latitude, longitude, _ = geodetic_e7(point)
        altitude_m = point.altitude_m
    return layout(mavlink.MAVLink_ahrs2_message)(
        *body.attitude_rad, altitude_m, latitude, longitude
    )


def vfr_hud(copter: ArduCopter) -> Any:
    """VFR_HUD."""
    return common.vfr_hud(copter, 0.0, 0 if copter.landed else 36) if copter.initialised else None
