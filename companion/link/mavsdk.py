"""The second backend: MAVSDK 4 reads and writes the messages, the loop keeps the wire.

MAVSDK runs inside this process on its ``raw://`` connection. Every frame that somebody wants is
handed to it and comes back by its MavlinkDirectServer subscription; every message that we send is
handed to MavlinkDirectServer and comes back as bytes. Sockets, discovery, requests, telemetry and
heartbeats are those of the pymavlink backend, so both keep one contract, signing included.

Why not MAVSDK's own connections: its threads send by themselves and go on when the caller hangs.
The Offboard plugin repeats the last setpoint for ever, its HEARTBEAT says MAV_STATE_UNINIT and
cannot be told otherwise, and it sends commands to every system it discovers, targets too. Here
nothing of that leaves: what MAVSDK makes is sent by the loop, once, if we asked for it, and dropped
if not. ``first_autopilot`` is not asked either: it takes whoever is heard first.

What differs from the pymavlink backend:

- MAVSDK's own messages are told from ours by their content, so a message leaves only if MAVSDK
  and pymavlink make the same payload of it. Header and checksum are the loop's: MAVSDK's sequence
  numbers count what is dropped.
- MAVSDK does not show what is addressed to other systems, which is nothing to us, and sends only
  to systems that it has heard, which are all that we address.
- Every message costs two changes of threads, some 0.1 ms on an idle machine.
- An infinite number in a message reads as NaN: MAVSDK hands fields over as JSON, which has neither.
"""

import json
import logging
import math
from queue import Empty, SimpleQueue
from typing import Any, TypeVar

from mavsdk import Configuration, Mavsdk
from mavsdk.cmavsdk_loader import _cmavsdk_lib
from mavsdk.connection_result import ConnectionResult
from mavsdk.logging import LogCallback, LogLevel
from mavsdk.plugins.mavlink_direct_server import (
    MavlinkDirectServer,
    MavlinkDirectServerError,
    MavlinkMessage,
)
from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.errors import LinkLostError, LinkOpenError
from companion.link.codec import Codec, Received, is_readable

_PATIENCE_S = 2.0
"""MAVSDK answers in well under a millisecond; after this its threads are stuck."""
_STALL_S = 0.1
_MARKS_OF_A_FRAME = 12
"""Longer, together, than any frame."""
_MARK = "NAMED_VALUE_INT"
_MARK_NAME = b"mark"

_T = TypeVar("_T")
_LOG = logging.getLogger("companion.mavsdk")


class MavsdkCodec(Codec):
    """Decodes and encodes by MAVSDK; a codec like the other, but with threads of its own."""

    def __init__(self, system_id: int, component_id: int) -> None:
        """Start MAVSDK.

        Raises:
            LinkOpenError: If it does not start.
        """
        super().__init__(system_id, component_id)
        self._heard: SimpleQueue[MavlinkMessage] = SimpleQueue()
        self._made: SimpleQueue[None] = SimpleQueue()
        self._awaited = b""
        self._marks = 0
        _cmavsdk_lib.mavsdk_log_subscribe(_LOG_CALLBACK, None)
        self._start()

    def become(self, system_id: int) -> None:
        """Speak as ``system_id`` from now on; MAVSDK keeps what is for others to itself."""
        if system_id != self.system_id:
            super().become(system_id)
            self.close()
            self._start()

    def decode(self, received: Received) -> Any | None:
        """Return what MAVSDK reads, as pymavlink's message object; ``None`` if it reads nothing.

        Raises:
            LinkLostError: If MAVSDK hangs.
        """
        known = dialect.mavlink_map.get(received.message_id)
        if known is None or not is_readable(received.frame):
            return None  # MAVSDK would take what follows an unknown flag for a part of the frame
        # MAVSDK says nothing of a frame that it does not like: the mark behind it tells
        self._marks = (self._marks + 1) & 0x7FFFFFFF
        mark = dialect.MAVLink_named_value_int_message(0, _MARK_NAME, self._marks)
        mark_frame = bytes(mark.pack(self._marker))
        self._mavsdk.pass_received_raw_bytes(received.frame + mark_frame)
        wanted = (known.msgname, received.system_id, received.component_id)
        while True:
            try:
                message = self._heard.get(timeout=_STALL_S)
            except Empty:  # MAVSDK may have taken the mark for a part of a long frame
                self._mavsdk.pass_received_raw_bytes(mark_frame * _MARKS_OF_A_FRAME)
                message = _answer(self._heard)
            if message.message_name == _MARK:
                if json.loads(message.fields_json)["value"] == self._marks:
                    return None
            elif (message.message_name, message.system_id, message.component_id) == wanted:
                fields = json.loads(message.fields_json)
                return known(**{key: _field(fields[key]) for key in known.fieldnames})

    def encode(self, message: Any) -> bytes:
        """Return ``message`` as MAVSDK writes it, with the next sequence number.

        Raises:
            LinkLostError: If MAVSDK hangs, refuses it, or makes another payload of it.
        """
        name = message.get_type()
        frame = super().encode(message)
        self._awaited = _content(frame)
        try:
            self._server.send_message(
                MavlinkMessage(
                    message_name=name,
                    system_id=self.system_id,
                    component_id=self.component_id,
                    target_system_id=getattr(message, "target_system", 0),
                    target_component_id=getattr(message, "target_component", 0),
                    fields_json=json.dumps(
                        {key: _plain(getattr(message, key)) for key in message.fieldnames}
                    ),
                )
            )
        except MavlinkDirectServerError as error:
            raise LinkLostError(f"MAVSDK refuses to send {name}: {error.result.name}") from error
        _answer(self._made)
        return frame

    def _start(self) -> None:
        self._marker = dialect.MAVLink(None, self.system_id, self.component_id)
        me = Configuration.create_manual(self.system_id, self.component_id, False)
        self._mavsdk = Mavsdk(me)
        result = self._mavsdk.add_any_connection("raw://")
        component = self._mavsdk.server_component_by_id(self.component_id)
        if result != ConnectionResult.SUCCESS or component is None:
            self._mavsdk.destroy()
            raise LinkOpenError(f"MAVSDK does not start: {result.name}")
        self._mavsdk.subscribe_raw_bytes_to_be_sent(self._take_bytes)
        self._server = MavlinkDirectServer(component)
        self._server.subscribe_message("", self._take_message)

    def close(self) -> None:
        """Stop MAVSDK and its threads."""
        self._mavsdk.destroy()

    # -- called by the threads of MAVSDK ---------------------------------------------------

    def _take_message(self, message: MavlinkMessage, _: None) -> None:
        self._heard.put(message)

    def _take_bytes(self, frame: bytes) -> None:
        if self._awaited and _content(frame) == self._awaited:
            self._awaited = b""
            self._made.put(None)


def _answer(answers: "SimpleQueue[_T]") -> _T:
    try:
        return answers.get(timeout=_PATIENCE_S)
    except Empty:
        raise LinkLostError(f"MAVSDK does not answer for {_PATIENCE_S:g} s") from None


def _content(frame: bytes) -> bytes:
    """Return message id and payload of a MAVLink 2 frame."""
    return frame[7 : 10 + frame[1]]


def _plain(value: Any) -> Any:
    """Return a field as JSON can hold it; NaN is null."""
    if isinstance(value, float) and math.isnan(value):
        return None
    if isinstance(value, bytes | list | tuple):
        return [_plain(item) for item in value]
    return value


def _field(value: Any) -> Any:
    """Return a field as pymavlink's messages are made of them."""
    if isinstance(value, str):
        return value.encode("ascii", errors="replace")
    if isinstance(value, list):
        return [_field(item) for item in value]
    return math.nan if value is None else value


def _log(level: int, text: bytes, _file: bytes, _line: int, _data: None) -> bool:
    """Take MAVSDK's words off the terminal; problems are told by our own errors."""
    _LOG.debug("%s: %s", LogLevel(level).name.lower(), text.decode(errors="replace"))
    return True


# not by mavsdk.logging.log_subscribe: it prints to stdout where a STATUSTEXT is not UTF-8
_LOG_CALLBACK = LogCallback(_log)
