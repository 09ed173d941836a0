"""What every autopilot does alike with messages addressed to it.

What differs stands in the ``incoming`` of each autopilot.
"""

import struct
from collections.abc import Callable, Mapping
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim.mock.autopilot import ERROR, Autopilot
from sim.mock.channel import Channel
from sim.mock.packet import MAVLINK2, Definition

FTP_NAK, FTP_FAIL = 129, 1
_PARAM_VALUE = Definition(mavlink.MAVLINK_MSG_ID_PARAM_VALUE, crc_extra=220)
"""Its fields are put into bytes here, for bit patterns that no float survives."""

Handler = Callable[[Any, Any, Any], None]
"""Takes an autopilot, the link (its own kinds of both) and the message."""


def handle(
    handlers: Mapping[str, Handler], autopilot: Autopilot, channel: Channel, message: Any
) -> None:
    """React to one message; what is not known is ignored."""
    handler = handlers.get(message.get_type())
    if handler is not None:
        handler(autopilot, channel, message)


def _timesync(autopilot: Autopilot, channel: Channel, message: Any) -> None:
    if message.tc1 == 0:
        channel.send(mavlink.MAVLink_timesync_message(round(autopilot.now_s * 1e9), message.ts1))


def _ping(autopilot: Autopilot, channel: Channel, message: Any) -> None:
    if message.target_system == 0 and message.target_component == 0:
        sender = message.get_srcSystem(), message.get_srcComponent()
        channel.send(mavlink.MAVLink_ping_message(message.time_usec, message.seq, *sender))


def _send_parameter(autopilot: Autopilot, channel: Channel, name: str, index: int) -> None:
    table = autopilot.parameters
    count, wire_type = len(table), table.wire_type(name)
    text = name.encode().ljust(16, b"\0")
    tail = struct.pack("<HH16sB", count, index, text, wire_type)
    channel.send((_PARAM_VALUE, table.wire_bytes(name) + tail))


def _param_read(autopilot: Autopilot, channel: Channel, message: Any) -> None:
    table = autopilot.parameters
    named = message.param_index < 0
    name = message.param_id if named else table.name_at(message.param_index)
    if name is not None and table.wire_type(name) is not None:  # an unknown one gets no answer
        index = table.index_when_named(name) if named else message.param_index
        _send_parameter(autopilot, channel, name, index)


def _param_list(autopilot: Autopilot, channel: Channel, message: Any) -> None:
    for index in range(len(autopilot.parameters)):
        name = autopilot.parameters.name_at(index)
        if name is not None:
            _send_parameter(autopilot, channel, name, index)


def _param_set(autopilot: Autopilot, channel: Channel, message: Any) -> None:
    packet = bytes(message.get_msgbuf())
    header, checksum = (10, 2) if packet[0] == MAVLINK2 else (6, 2)
    raw = packet[header : min(header + 4, len(packet) - checksum)].ljust(4, b"\0")
    table, name = autopilot.parameters, message.param_id
    if table.store(name, message.param_type, raw):
        _send_parameter(autopilot, channel, name, table.index_when_named(name))


def _mission_list(autopilot: Autopilot, channel: Channel, message: Any) -> None:
    sender = message.get_srcSystem(), message.get_srcComponent()
    channel.send(mavlink.MAVLink_mission_count_message(*sender, 0, message.mission_type))


def _mission_upload(autopilot: Autopilot, channel: Channel, message: Any) -> None:
    """Refuse an upload, but for one of no items: that clears what is not there."""
    empty = message.count == 0
    result = mavlink.MAV_MISSION_ACCEPTED if empty else mavlink.MAV_MISSION_UNSUPPORTED
    _acknowledge_mission(channel, message, result)


def _mission_item(autopilot: Autopilot, channel: Channel, message: Any) -> None:
    """Refuse a request for an item: there are none."""
    _acknowledge_mission(channel, message, mavlink.MAV_MISSION_UNSUPPORTED)


def _mission_clear(autopilot: Autopilot, channel: Channel, message: Any) -> None:
    _acknowledge_mission(channel, message, mavlink.MAV_MISSION_ACCEPTED)


def _acknowledge_mission(channel: Channel, message: Any, result: int) -> None:
    sender = message.get_srcSystem(), message.get_srcComponent()
    channel.send(mavlink.MAVLink_mission_ack_message(*sender, result, message.mission_type))


def _log_list(autopilot: Autopilot, channel: Channel, message: Any) -> None:
    channel.send(mavlink.MAVLink_log_entry_message(0, 0, 0, 0, 0))


def _ftp(autopilot: Autopilot, channel: Channel, message: Any) -> None:
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


def _setup_signing(autopilot: Autopilot, channel: Channel, message: Any) -> None:
    """SETUP_SIGNING: a key for all links, on the ground only; zeros end signing."""
    if autopilot.armed:
        autopilot.say(ERROR, "ERROR: Won't setup signing when armed")
        return
    channel.keyring.set_up(bytes(message.secret_key), message.initial_timestamp)


SHARED_HANDLERS: dict[str, Handler] = {
    "SETUP_SIGNING": _setup_signing,
    "TIMESYNC": _timesync,
    "PING": _ping,
    "PARAM_REQUEST_READ": _param_read,
    "PARAM_REQUEST_LIST": _param_list,
    "PARAM_SET": _param_set,
    "MISSION_REQUEST_LIST": _mission_list,
    "MISSION_COUNT": _mission_upload,
    "MISSION_REQUEST_INT": _mission_item,
    "MISSION_REQUEST": _mission_item,
    "MISSION_CLEAR_ALL": _mission_clear,
    "LOG_REQUEST_LIST": _log_list,
    "FILE_TRANSFER_PROTOCOL": _ftp,
}
