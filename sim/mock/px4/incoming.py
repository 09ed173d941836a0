"""What PX4 does with messages addressed to it."""

import math
from collections.abc import Collection
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.world.frames import GeoPoint
from sim.mock.autopilot import COMPONENT_ID
from sim.mock.channel import Channel
from sim.mock.commands import NOT_GIVEN, Command, CommandId, Result, read_command, whole
from sim.mock.dynamics import Vector
from sim.mock.incoming import SHARED_HANDLERS, Handler
from sim.mock.pilot import Sticks
from sim.mock.px4.commander import Px4
from sim.mock.px4.commands import run_command, set_mode
from sim.mock.px4.setpoints import read_setpoint
from sim.mock.setpoints import MAV_FRAME_LOCAL_NED, Setpoint

_AMSL_FRAMES = (mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_FRAME_GLOBAL_INT)
_RELATIVE_FRAMES = (
    mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT,
    mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
)
NAN_BITS = 0x7FF80000
"""What a NaN becomes in x and y of COMMAND_INT."""


def is_for_us(message: Any, system_id: int, elsewhere: Collection[tuple[int, int]]) -> bool:
    """Return whether the target ids of ``message`` name this autopilot, or nobody (P10)."""
    system = getattr(message, "target_system", 0)
    component = getattr(message, "target_component", 0)
    return system in (0, system_id) and component in (0, COMPONENT_ID)


def _heartbeat(px4: Px4, channel: Channel, message: Any) -> None:
    if message.type == mavlink.MAV_TYPE_GCS:
        channel.hear_gcs(px4.now_s)
    elif (
        message.type == mavlink.MAV_TYPE_ONBOARD_CONTROLLER
        and message.get_srcSystem() == px4.system_id
    ):
        px4.companion.hear(px4.now_s)


def _command(px4: Px4, channel: Channel, message: Any) -> None:
    if message.target_system != px4.system_id:
        return  # commands to everybody are not ours to answer
    command = read_command(message)
    number, first = command.command, whole(command.params[0])
    if _mistaken(message):
        result = Result.DENIED
    elif number == CommandId.SET_MESSAGE_INTERVAL:
        result = _set_interval(px4, channel, command)
    elif number == CommandId.GET_MESSAGE_INTERVAL:
        interval_us = channel.interval_us(first)
        channel.send(mavlink.MAVLink_message_interval_message(first & 0xFFFF, interval_us))
        result = Result.ACCEPTED
    elif number == CommandId.REQUEST_MESSAGE:
        result = _send_once(px4, channel, first)
    elif (message.get_srcSystem(), message.get_srcComponent()) == (px4.system_id, COMPONENT_ID):
        return  # somebody calls himself the autopilot
    else:
        result = run_command(px4, command)
    channel.acknowledge(px4.now_s, message, number, result)


def _mistaken(message: Any) -> bool:
    """Return whether "not given" was written as the other of the two messages writes it."""
    if message.get_type() == "COMMAND_LONG":
        return bool(message.param5 == message.param6 == float(NOT_GIVEN + 1))
    return bool(message.x == message.y == NAN_BITS)


def _set_interval(px4: Px4, channel: Channel, command: Command) -> Result:
    """Handle SET_MESSAGE_INTERVAL; HEARTBEAT stays, and nothing may be asked for besides."""
    number, interval_us = whole(command.params[0]), command.params[1]
    besides = [whole(command.params[index] + 0.5) for index in (2, 3, 6)]
    if number == mavlink.MAVLINK_MSG_ID_HEARTBEAT or any(value > 0 for value in besides):
        return Result.FAILED
    wanted_us = interval_us if math.isfinite(interval_us) else 0.0
    return Result.ACCEPTED if channel.set_interval(number, wanted_us, px4.now_s) else Result.FAILED


def _send_once(px4: Px4, channel: Channel, message_id: int) -> Result:
    build = channel.builders.get(message_id)
    message = None if build is None else build(px4)
    if message is None:
        return Result.DENIED
    channel.send(message)
    return Result.ACCEPTED


def _set_mode(px4: Px4, channel: Channel, message: Any) -> None:
    main, sub = message.custom_mode >> 16 & 0xFF, message.custom_mode >> 24 & 0xFF
    result = set_mode(px4, message.base_mode, main, sub, message.get_srcComponent())
    channel.acknowledge(px4.now_s, message, CommandId.DO_SET_MODE, result)


def _local_setpoint(px4: Px4, channel: Channel, message: Any) -> None:
    position_m = (message.x, message.y, message.z)
    name = "SET_POSITION_TARGET_LOCAL_NED"
    _take(px4, message, name, position_m, message.coordinate_frame)


def _take(px4: Px4, message: Any, name: str, position_m: Vector, frame: int) -> None:
    setpoint = read_setpoint(
        name,
        frame=frame,
        type_mask=message.type_mask,
        position_m=position_m,
        velocity_mps=(message.vx, message.vy, message.vz),
        acceleration_mps2=(message.afx, message.afy, message.afz),
        yaw_rad=message.yaw,
        yaw_rate_radps=message.yaw_rate,
        heading_rad=px4.body.yaw_rad,
    )
    if isinstance(setpoint, str):
        px4.refuse_setpoint(setpoint)
    else:
        px4.receive_setpoint(setpoint)


def _global_setpoint(px4: Px4, channel: Channel, message: Any) -> None:
    """SET_POSITION_TARGET_GLOBAL_INT: the same setpoint with its position on earth."""
    name = "SET_POSITION_TARGET_GLOBAL_INT"
    if message.coordinate_frame not in (*_AMSL_FRAMES, *_RELATIVE_FRAMES):
        px4.refuse_setpoint(f"{name} invalid coordinate frame {message.coordinate_frame}")
        return
    altitude_m = message.alt
    if message.coordinate_frame in _RELATIVE_FRAMES and px4.home_true_m is not None:
        altitude_m += px4.estimator.altitude_m(px4.home_true_m)
    point = GeoPoint(message.lat_int / 1e7, message.lon_int / 1e7, altitude_m)
    position_m = px4.estimator.to_local(px4.estimator.from_geodetic(point))
    _take(px4, message, name, position_m, MAV_FRAME_LOCAL_NED)


def _attitude_target(px4: Px4, channel: Channel, message: Any) -> None:
    """SET_ATTITUDE_TARGET: a sign of life like any setpoint (P1); a point mass cannot tilt."""
    px4.receive_setpoint(Setpoint())


def _manual_control(px4: Px4, channel: Channel, message: Any) -> None:
    if message.target != px4.system_id:
        return
    axes = (message.x / 1e3, message.y / 1e3, message.z / 500.0 - 1.0, message.r / 1e3)
    if all(-1.0 <= axis <= 1.0 for axis in axes):  # PX4 too ignores what no stick can say
        px4.pilot.move(px4.now_s, Sticks(*axes))


HANDLERS: dict[str, Handler] = {
    **SHARED_HANDLERS,
    "HEARTBEAT": _heartbeat,
    "COMMAND_LONG": _command,
    "COMMAND_INT": _command,
    "SET_MODE": _set_mode,
    "SET_POSITION_TARGET_LOCAL_NED": _local_setpoint,
    "SET_POSITION_TARGET_GLOBAL_INT": _global_setpoint,
    "SET_ATTITUDE_TARGET": _attitude_target,
    "MANUAL_CONTROL": _manual_control,
}
