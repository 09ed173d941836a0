"""A packet on its way: a message that is put into bytes when somebody looks at it.

A client in the same process reads few of the hundreds of packets a second; the others are never
encoded. On sockets all of them are.
"""

from functools import partial
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

MAVLINK2 = 0xFD


def message_id(packet: bytes) -> int:
    """Return the message id of one complete MAVLink packet."""
    return int.from_bytes(packet[7:10], "little") if packet[0] == MAVLINK2 else packet[5]


def sender_of(packet: bytes) -> tuple[int, int]:
    """Return the system and component id of one complete MAVLink packet."""
    first = 5 if packet[0] == MAVLINK2 else 3
    return packet[first], packet[first + 1]


class Packet:
    """One packet, of this autopilot or passed on for somebody else."""

    __slots__ = ("_codec", "_data", "_message", "_sequence", "message_id")

    def __init__(self, message: Any, codec: Any) -> None:
        """Take ``message`` with the present sequence number of ``codec``, and count it up.

        A message may also be a ``functools.partial`` that builds it.
        """
        draft: Any = message.func if type(message) is partial else None
        # Not .id of a message: STATUSTEXT has a field of that name.
        self.message_id: int = message._header.msgId if draft is None else draft.id
        self._message, self._codec = message, codec
        self._sequence: int = codec.seq
        self._data: bytes | None = None
        codec.seq = (codec.seq + 1) & 0xFF

    @classmethod
    def of(cls, data: bytes) -> "Packet":
        """Return the packet that has these bytes."""
        packet = cls.__new__(cls)
        packet.message_id = message_id(data) if len(data) > 9 else -1
        packet._data = data
        return packet

    @property
    def data(self) -> bytes:
        """Return its bytes."""
        if self._data is None:
            codec = self._codec
            newest, codec.seq = codec.seq, self._sequence
            message = self._message
            self._data = (message() if type(message) is partial else message).pack(codec)
            codec.seq = newest
            self._message = self._codec = None
        return self._data

    @property
    def name(self) -> str:
        """Return the name of the message, ``UNKNOWN`` where pymavlink has none."""
        known = mavlink.mavlink_map.get(self.message_id)
        return "UNKNOWN" if known is None else str(known.msgname)


class RawMessage(mavlink.MAVLink_message):  # type: ignore[misc]
    """A message of which only the bytes are known.

    Args:
        message_id: Its id.
        name: Its name in the definitions.
        crc_extra: Its checksum seed.
        payload: Its fields in wire order.
    """

    def __init__(self, message_id: int, name: str, crc_extra: int, payload: bytes) -> None:
        super().__init__(message_id, name)
        self._seed = crc_extra
        self._fields = payload

    def pack(self, mav: Any, force_mavlink1: bool = False) -> bytes:
        """Return the packet."""
        packet: bytes = self._pack(mav, self._seed, self._fields, force_mavlink1=force_mavlink1)
        return packet
