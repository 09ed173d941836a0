"""What the PX4 personality does with messages addressed to it."""

import struct
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.world.frames import GeoPoint
from sim.mock.channel import COMPONENT_ID, SYSTEM_ID, Channel
from sim.mock.commands import Command, CommandId, Result, run_command, set_mode, whole
from sim.mock.dynamics import Vector
from sim.mock.pilot import Sticks
from sim.mock.px4 import Px4
from sim.mock.setpoints import MAV_FRAME_LOCAL_NED, read_setpoint
from sim.mock.streams import STREAMS
from sim.mock.wire import MAVLINK2

FTP_NAK, FTP_FAIL = 129, 1
_AMSL_FRAMES = (mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_FRAME_GLOBAL_INT)
_RELATIVE_FRAMES = (
    mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT,
    mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
)
_DEGREES_E7 = (mavlink.MAV_CMD_DO_REPOSITION, mavlink.MAV_CMD_NAV_TAKEOFF)


def is_for_us(message: Any) -> bool:
    """Return whether the target ids of ``message`` name this autopilot, or nobody (P10)."""
    system = getattr(message, "target_system", 0)
    component = getattr(message, "target_component", 0)
    return system in (0, SYSTEM_ID) and component in (0, COMPONENT_ID)


def handle(px4: Px4, channel: Channel, message: Any) -> None:
    """React to one message; what is not known is ignored."""
    handler = _HANDLERS.get(message.get_type())
    if handler is not None:
        handler(px4, channel, message)


def _heartbeat(px4: Px4, channel: Channel, message: Any) -> None:
    if message.type == mavlink.MAV_TYPE_GCS:
        channel.hear_gcs(px4.now_s)
    elif (
        message.type == mavlink.MAV_TYPE_ONBOARD_CONTROLLER and message.get_srcSystem() == SYSTEM_ID
    ):
        px4.companion.hear(px4.now_s)


def _command_long(px4: Px4, channel: Channel, message: Any) -> None:
    params = tuple(getattr(message, f"param{number}") for number in range(1, 8))
    _command(px4, channel, message, params)


def _command_int(px4: Px4, channel: Channel, message: Any) -> None:
    x, y = float(message.x), float(message.y)
    if message.command in _DEGREES_E7:
        # INT32_MAX says "not given", as NaN does in COMMAND_LONG.
        x, y = (value / 1e7 if value != 2**31 - 1 else float("nan") for value in (x, y))
    params = (message.param1, message.param2, message.param3, message.param4, x, y, message.z)
    _command(px4, channel, message, params)


def _command(px4: Px4, channel: Channel, message: Any, params: Any) -> None:
    if message.target_system != SYSTEM_ID:
        return  # commands to everybody are not ours to answer
    number = message.command
    if number == CommandId.SET_MESSAGE_INTERVAL:
        known = channel.set_interval(whole(params[0]), params[1], px4.now_s)
        result = Result.ACCEPTED if known else Result.FAILED
    elif number == CommandId.REQUEST_MESSAGE:
        result = _send_once(px4, channel, whole(params[0]))
    else:
        result = run_command(px4, Command(number, params, message.get_srcComponent()))
    _acknowledge(channel, message, number, result)


def _acknowledge(channel: Channel, message: Any, number: int, result: Result) -> None:
    channel.send(
        mavlink.MAVLink_command_ack_message(
            number, result, 0, 0, message.get_srcSystem(), message.get_srcComponent()
        )
    )


def _send_once(px4: Px4, channel: Channel, message_id: int) -> Result:
    stream = STREAMS.get(message_id)
    if stream is None:
        return Result.UNSUPPORTED
    message = stream.build(px4)
    if message is None:
        return Result.TEMPORARILY_REJECTED
    channel.send(message)
    return Result.ACCEPTED


def _set_mode(px4: Px4, channel: Channel, message: Any) -> None:
    main, sub = message.custom_mode >> 16 & 0xFF, message.custom_mode >> 24 & 0xFF
    result = set_mode(px4, message.base_mode, main, sub, message.get_srcComponent())
    _acknowledge(channel, message, CommandId.DO_SET_MODE, result)


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
        altitude_m += px4.estimator.geodetic(px4.home_true_m).altitude_m
    point = GeoPoint(message.lat_int / 1e7, message.lon_int / 1e7, altitude_m)
    position_m = px4.estimator.to_local(px4.estimator.from_geodetic(point))
    _take(px4, message, name, position_m, MAV_FRAME_LOCAL_NED)


def _manual_control(px4: Px4, channel: Channel, message: Any) -> None:
    if message.target != SYSTEM_ID:
        return
    axes = (message.x / 1e3, message.y / 1e3, message.z / 500.0 - 1.0, message.r / 1e3)
    if all(-1.0 <= axis <= 1.0 for axis in axes):  # PX4 too ignores what no stick can say
        px4.pilot.move(px4.now_s, Sticks(*axes))


def _timesync(px4: Px4, channel: Channel, message: Any) -> None:
    if message.tc1 == 0:
        channel.send(mavlink.MAVLink_timesync_message(round(px4.now_s * 1e9), message.ts1))


def _ping(px4: Px4, channel: Channel, message: Any) -> None:
    if message.target_system == 0 and message.target_component == 0:
        sender = message.get_srcSystem(), message.get_srcComponent()
        channel.send(mavlink.MAVLink_ping_message(message.time_usec, message.seq, *sender))


def send_parameter(px4: Px4, channel: Channel, name: str) -> None:
    """Send PARAM_VALUE, byte-wise."""
    index, count = px4.parameters.index_of(name), len(px4.parameters)
    wire_type = px4.parameters.wire_type(name)
    text = name.encode().ljust(16, b"\0")
    message = mavlink.MAVLink_param_value_message(text, 0.0, wire_type, count, index)
    tail = struct.pack("<HH16sB", count, index, text, wire_type)
    channel.send_raw_payload(message, px4.parameters.wire_bytes(name) + tail)


def _param_read(px4: Px4, channel: Channel, message: Any) -> None:
    named = message.param_index < 0
    name = message.param_id if named else px4.parameters.name_at(message.param_index)
    if name is not None and px4.parameters.wire_type(name) is not None:
        send_parameter(px4, channel, name)  # an unknown one gets no answer


def _param_list(px4: Px4, channel: Channel, message: Any) -> None:
    for index in range(len(px4.parameters)):
        name = px4.parameters.name_at(index)
        if name is not None:
            send_parameter(px4, channel, name)


def _param_set(px4: Px4, channel: Channel, message: Any) -> None:
    packet = bytes(message.get_msgbuf())
    header, checksum = (10, 2) if packet[0] == MAVLINK2 else (6, 2)
    raw = packet[header : min(header + 4, len(packet) - checksum)].ljust(4, b"\0")
    if px4.parameters.store(message.param_id, message.param_type, raw):
        send_parameter(px4, channel, message.param_id)


def _mission_list(px4: Px4, channel: Channel, message: Any) -> None:
    sender = message.get_srcSystem(), message.get_srcComponent()
    channel.send(mavlink.MAVLink_mission_count_message(*sender, 0, message.mission_type))


def _log_list(px4: Px4, channel: Channel, message: Any) -> None:
    channel.send(mavlink.MAVLink_log_entry_message(0, 0, 0, 0, 0))


def _ftp(px4: Px4, channel: Channel, message: Any) -> None:
    request = bytes(message.payload)
    sequence = (int.from_bytes(request[:2], "little") + 1) % 65536
    # seq, session, opcode, size, req_opcode, burst, padding, offset, data[0] = error code
    answer = struct.pack(
        "<HBBBBBBIB", sequence, request[2], FTP_NAK, 1, request[3], 0, 0, 0, FTP_FAIL
    )
    sender = message.get_srcSystem(), message.get_srcComponent()
    channel.send(
        mavlink.MAVLink_file_transfer_protocol_message(0, *sender, answer.ljust(251, b"\0"))
    )


_HANDLERS: dict[str, Callable[[Px4, Channel, Any], None]] = {
    "HEARTBEAT": _heartbeat,
    "COMMAND_LONG": _command_long,
    "COMMAND_INT": _command_int,
    "SET_MODE": _set_mode,
    "SET_POSITION_TARGET_LOCAL_NED": _local_setpoint,
    "SET_POSITION_TARGET_GLOBAL_INT": _global_setpoint,
    "MANUAL_CONTROL": _manual_control,
    "TIMESYNC": _timesync,
    "PING": _ping,
    "PARAM_REQUEST_READ": _param_read,
    "PARAM_REQUEST_LIST": _param_list,
    "PARAM_SET": _param_set,
    "MISSION_REQUEST_LIST": _mission_list,
    "LOG_REQUEST_LIST": _log_list,
    "FILE_TRANSFER_PROTOCOL": _ftp,
}
