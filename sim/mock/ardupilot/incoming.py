"""What ArduCopter does with messages addressed to it."""

import math
from collections.abc import Collection
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.world.frames import GeoPoint
from sim.mock.ardupilot.channel import CopterChannel
from sim.mock.ardupilot.commands import AMSL_FRAMES, RELATIVE_FRAMES, run_command, set_mode
from sim.mock.ardupilot.copter import ArduCopter
from sim.mock.ardupilot.setpoints import read_setpoint
from sim.mock.autopilot import COMPONENT_ID, INFO
from sim.mock.channel import Channel
from sim.mock.commands import CommandId, Result, read_command, whole
from sim.mock.dynamics import Vector
from sim.mock.incoming import SHARED_HANDLERS, Handler
from sim.mock.pilot import Sticks
from sim.mock.setpoints import MAV_FRAME_LOCAL_NED


def is_for_us(message: Any, system_id: int, elsewhere: Collection[tuple[int, int]]) -> bool:
    """Return whether ArduPilot takes a message for its own.

    It also answers for components that nobody has heard of: one that lives on another link gets
    its messages, anything else is ours (recorded: component 200 is answered).
    """
    system = getattr(message, "target_system", 0)
    component = getattr(message, "target_component", 0)
    if system not in (0, system_id):
        return False
    return component in (0, COMPONENT_ID) or (system, component) not in elsewhere


def _heartbeat(copter: ArduCopter, channel: Channel, message: Any) -> None:
    if message.get_srcSystem() == int(copter.parameters.number("SYSID_MYGCS")):
        copter.failsafes.gcs_heard_s = copter.now_s


def _command(copter: ArduCopter, channel: Channel, message: Any) -> None:
    command = read_command(message)
    number, first = command.command, whole(command.params[0])
    if number == CommandId.SET_MESSAGE_INTERVAL:
        known = channel.set_interval(first, _interval_us(command.params[1]), copter.now_s)
        if not known:
            copter.say(INFO, f"No ap_message for mavlink id ({first})")
        channel.acknowledge(
            copter.now_s, message, number, Result.ACCEPTED if known else Result.DENIED
        )
    elif number == CommandId.GET_MESSAGE_INTERVAL:
        known = first in channel.builders
        interval_us = (channel.interval_us(first) or -1) if known else 0
        channel.send(mavlink.MAVLink_message_interval_message(first & 0xFFFF, interval_us))
        channel.acknowledge(
            copter.now_s, message, number, Result.ACCEPTED if known else Result.FAILED
        )
    elif number == CommandId.REQUEST_MESSAGE:
        known = first in channel.builders
        channel.acknowledge(
            copter.now_s, message, number, Result.ACCEPTED if known else Result.FAILED
        )
        if known:
            _send_once(copter, channel, first)  # after the ACK
    elif number == CommandId.REQUEST_AUTOPILOT_CAPABILITIES:
        channel.acknowledge(copter.now_s, message, number, Result.ACCEPTED)
        _send_once(copter, channel, mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
    elif number == CommandId.GET_HOME_POSITION:
        known = copter.home_true_m is not None
        channel.acknowledge(
            copter.now_s, message, number, Result.ACCEPTED if known else Result.FAILED
        )
        _send_once(copter, channel, mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN)
        _send_once(copter, channel, mavlink.MAVLINK_MSG_ID_HOME_POSITION)
    else:
        channel.acknowledge(copter.now_s, message, number, run_command(copter, command))


def _interval_us(asked_us: float) -> float:
    """Return an interval as ArduPilot takes it: whole milliseconds up to a minute."""
    if asked_us in (0.0, -1.0) or not math.isfinite(asked_us):
        return asked_us
    return 1e3 * min(60_000, max(1, int(asked_us) // 1000))


def _send_once(copter: ArduCopter, channel: Channel, message_id: int) -> None:
    message = channel.builders[message_id](copter)
    if message is not None:
        channel.send(message)


def _set_mode(copter: ArduCopter, channel: Channel, message: Any) -> None:
    set_mode(copter, message.base_mode, message.custom_mode)  # obeyed, never answered


def _request_data_stream(copter: ArduCopter, channel: CopterChannel, message: Any) -> None:
    rate_hz = float(message.req_message_rate) if message.start_stop == 1 else 0.0
    channel.request_stream(message.req_stream_id, rate_hz, copter.now_s)


def _local_setpoint(copter: ArduCopter, channel: Channel, message: Any) -> None:
    position_m = (message.x, message.y, message.z)
    _take(copter, message, position_m, message.coordinate_frame)


def _global_setpoint(copter: ArduCopter, channel: Channel, message: Any) -> None:
    """SET_POSITION_TARGET_GLOBAL_INT: the same setpoint with its position on earth."""
    altitude_m = message.alt
    if message.coordinate_frame in RELATIVE_FRAMES and copter.home_true_m is not None:
        altitude_m += copter.estimator.altitude_m(copter.home_true_m)
    elif message.coordinate_frame not in AMSL_FRAMES:
        copter.receive_setpoint(None)
        return
    point = GeoPoint(message.lat_int / 1e7, message.lon_int / 1e7, altitude_m)
    position_m = copter.estimator.to_local(copter.estimator.from_geodetic(point))
    _take(copter, message, position_m, MAV_FRAME_LOCAL_NED)


def _take(copter: ArduCopter, message: Any, position_m: Vector, frame: int) -> None:
    copter.receive_setpoint(
        read_setpoint(
            frame=frame,
            type_mask=message.type_mask,
            position_m=position_m,
            velocity_mps=(message.vx, message.vy, message.vz),
            acceleration_mps2=(message.afx, message.afy, message.afz),
            yaw_rad=message.yaw,
            yaw_rate_radps=message.yaw_rate,
            here_m=copter.estimator.to_local(copter.body.position_m),
            heading_rad=copter.body.yaw_rad,
        )
    )


def _manual_control(copter: ArduCopter, channel: Channel, message: Any) -> None:
    """MANUAL_CONTROL: sticks, from SYSID_MYGCS only."""
    if message.target != copter.system_id:
        return
    if message.get_srcSystem() != int(copter.parameters.number("SYSID_MYGCS")):
        return
    axes = (message.x / 1e3, message.y / 1e3, message.z / 500.0 - 1.0, message.r / 1e3)
    if all(-1.0 <= axis <= 1.0 for axis in axes):
        copter.pilot.move(copter.now_s, Sticks(*axes))


def _rc_override(copter: ArduCopter, channel: Channel, message: Any) -> None:
    """RC_CHANNELS_OVERRIDE: a transmitter, from SYSID_MYGCS only."""
    if message.get_srcSystem() == int(copter.parameters.number("SYSID_MYGCS")):
        copter.override_radio({n: getattr(message, f"chan{n}_raw") for n in range(1, 9)})


HANDLERS: dict[str, Handler] = {
    **SHARED_HANDLERS,
    "HEARTBEAT": _heartbeat,
    "COMMAND_LONG": _command,
    "COMMAND_INT": _command,
    "SET_MODE": _set_mode,
    "REQUEST_DATA_STREAM": _request_data_stream,
    "SET_POSITION_TARGET_LOCAL_NED": _local_setpoint,
    "SET_POSITION_TARGET_GLOBAL_INT": _global_setpoint,
    "MANUAL_CONTROL": _manual_control,
    "RC_CHANNELS_OVERRIDE": _rc_override,
}
