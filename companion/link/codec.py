"""MAVLink packets from bytes and back, without I/O.

Framing is ours, so that no byte from the wire can raise and every packet, wanted or not, is
checked and counted from its header; field layouts and CRC seeds are pymavlink's. Wire format:
https://mavlink.io/en/guide/serialization.html
"""

import re
from collections.abc import Callable
from typing import Any, NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

MAX_PACKET_BYTES = 280
"""MAVLink 2 with a full payload and a signature."""

STALE_PARTIAL_S = 0.5
"""A packet begun and not completed for this long was none; 280 bytes take 0.3 s at 9600 baud."""

_MAGIC_V1 = 0xFE
_MAGIC_V2 = 0xFD
_SIGNED = 0x01
_SIGNATURE_BYTES = 13
_NEXT_MAGIC = re.compile(rb"[\xfd\xfe]")

_CRC_SEEDS: dict[int, int] = {
    message_id: message.crc_extra for message_id, message in dialect.mavlink_map.items()
} | {
    # PX4 1.18 sends these; pymavlink 2.4.50 does not know them. The seeds are those that fit
    # every such packet of the recorded flights.
    8: 117,
    290: 251,
    291: 10,
    380: 232,
    410: 160,
    411: 106,
    436: 193,
    441: 169,
    514: 197,
}


class Received(NamedTuple):
    """One valid packet, its fields not yet decoded."""

    time_s: float
    """Arrival on our clock."""
    system_id: int
    component_id: int
    message_id: int
    frame: bytes
    """The packet as it came, header and checksum included."""

    @property
    def payload(self) -> bytes:
        """Return the payload as sent, its trailing zeros cut off."""
        start = 10 if self.frame[0] == _MAGIC_V2 else 6
        return self.frame[start : start + self.frame[1]]


class Parser:
    """Cut the byte stream of one peer into packets.

    Keep one for each peer: packets may straddle reads, and sequence numbers belong to a sender
    on a path.
    """

    def __init__(self, admits: Callable[[bytes, float], bool] | None = None) -> None:
        """Ask ``admits(frame, now_s)`` about every packet; one refused is as if never come."""
        self._admits = admits
        self._pending = b""
        self._pending_since_s = 0.0
        self._last_sequence: dict[tuple[int, int], int] = {}
        self.bytes_received = 0
        self.bytes_bad = 0
        """Bytes that belong to no valid packet."""
        self.packets_received = 0
        self.packets_lost: dict[tuple[int, int], int] = {}
        """Gaps in the sequence numbers, by ``(system_id, component_id)``."""

    def receive(self, data: bytes, now_s: float) -> list[Received]:
        """Return the packets completed by ``data``; what is incomplete is kept.

        Never raises. A packet whose checksum does not fit is searched for packets inside it,
        so a length that lies costs no packet that follows.
        """
        self.bytes_received += len(data)
        buffer = self._pending + data
        position = 0
        if self._pending and now_s - self._pending_since_s > STALE_PARTIAL_S:
            position = 1  # what looked like the start of a packet was none
            self.bytes_bad += 1
        packets: list[Received] = []
        while (start := self._skip_garbage(buffer, position)) is not None:
            size = _packet_size(buffer, start)
            if size is None or start + size > len(buffer):
                if start or not self._pending:
                    self._pending_since_s = now_s
                self._pending = buffer[start:]
                return packets
            if size and _is_intact(buffer, start, size):
                position = start + size
                frame = buffer[start:position]
                if self._admits is None or self._admits(frame, now_s):
                    packets.append(self._take(frame, now_s))
            else:
                self.bytes_bad += 1
                position = start + 1
        self._pending = b""
        return packets

    def _skip_garbage(self, buffer: bytes, position: int) -> int | None:
        """Return where the next packet may start, ``None`` if nowhere."""
        if position < len(buffer) and buffer[position] in (_MAGIC_V2, _MAGIC_V1):
            return position
        found = _NEXT_MAGIC.search(buffer, position)
        self.bytes_bad += (found.start() if found else len(buffer)) - position
        return found.start() if found else None

    def _take(self, frame: bytes, now_s: float) -> Received:
        if frame[0] == _MAGIC_V2:
            sequence, system_id, component_id = frame[4], frame[5], frame[6]
            message_id = frame[7] | frame[8] << 8 | frame[9] << 16
        else:
            sequence, system_id, component_id, message_id = frame[2:6]
        self.packets_received += 1
        sender = (system_id, component_id)
        last = self._last_sequence.get(sender)
        gap = 0 if last is None else (sequence - last - 1) % 256
        if gap < 128:  # beyond that it is a repeat or came out of order, not a loss
            self._last_sequence[sender] = sequence
            if gap:
                self.packets_lost[sender] = self.packets_lost.get(sender, 0) + gap
        return Received(now_s, system_id, component_id, message_id, frame)


def _packet_size(buffer: bytes, start: int) -> int | None:
    """Return the size a packet at ``start`` claims; 0 if it is none, ``None`` if unknown yet."""
    available = len(buffer) - start
    if buffer[start] == _MAGIC_V1:
        return buffer[start + 1] + 8 if available >= 2 else None
    if available < 3:
        return None
    flags = buffer[start + 2]
    if flags & ~_SIGNED:
        return 0
    return buffer[start + 1] + 12 + (_SIGNATURE_BYTES if flags & _SIGNED else 0)


def _is_intact(buffer: bytes, start: int, size: int) -> bool:
    """Check the packet by its checksum, or by what follows it where the seed is not known."""
    if buffer[start] == _MAGIC_V2:
        message_id = buffer[start + 7] | buffer[start + 8] << 8 | buffer[start + 9] << 16
        crc_at = start + 10 + buffer[start + 1]
    else:
        message_id = buffer[start + 5]
        crc_at = start + 6 + buffer[start + 1]
    seed = _CRC_SEEDS.get(message_id)
    if seed is None:
        end = start + size
        followed = end == len(buffer) or buffer[end] in (_MAGIC_V1, _MAGIC_V2)
        return followed and buffer[start] == _MAGIC_V2
    return _checksum(buffer[start + 1 : crc_at], seed) == buffer[crc_at : crc_at + 2]


def _checksum(content: bytes, seed: int) -> bytes:
    crc: int = dialect.x25crc(content + bytes((seed,))).crc
    return crc.to_bytes(2, "little")


def is_readable(frame: bytes) -> bool:
    """Return whether a packet has no incompatibility flags but the one of a signature."""
    return frame[0] == _MAGIC_V1 or not frame[2] & ~_SIGNED


def reheaded(frame: bytes, *, sequence: int, incompatible: int) -> bytes:
    """Return an unsigned MAVLink 2 frame with another header, its checksum made anew.

    Args:
        frame: Of a message that we send, so that its seed is known.
        sequence: 0 to 255.
        incompatible: The incompatibility flags.
    """
    content = bytes((frame[1], incompatible, frame[3], sequence)) + frame[5:-2]
    message_id = int.from_bytes(frame[7:10], "little")
    return frame[:1] + content + _checksum(content, _CRC_SEEDS[message_id])


class Codec:
    """Decode the fields of packets; encode messages of one sender with its sequence numbers."""

    def __init__(self, system_id: int, component_id: int) -> None:
        self._mavlink = dialect.MAVLink(None, system_id, component_id)

    @property
    def system_id(self) -> int:
        """The sender of what is encoded."""
        return int(self._mavlink.srcSystem)

    @property
    def component_id(self) -> int:
        """The sender of what is encoded."""
        return int(self._mavlink.srcComponent)

    def become(self, system_id: int) -> None:
        """Speak as ``system_id`` from now on."""
        self._mavlink.srcSystem = system_id

    def decode(self, received: Received) -> Any | None:
        """Return pymavlink's message object, or ``None`` where the payload does not fit it.

        Costs some 6 us; call it only for messages that somebody wants.
        """
        if received.message_id not in dialect.mavlink_map:
            return None
        try:
            return self._mavlink.decode(bytearray(received.frame))
        except dialect.MAVError:
            return None

    def encode(self, message: Any) -> bytes:
        """Return ``message`` as a MAVLink 2 packet with the next sequence number."""
        frame: bytes = message.pack(self._mavlink)
        self._mavlink.seq = (self._mavlink.seq + 1) % 256
        return frame

    def close(self) -> None:
        """Release what the codec holds: nothing, in this one."""
