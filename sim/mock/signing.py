"""MAVLink 2 signing as autopilots do it: ``mavlink_signature_check`` of the C library.

One keyring belongs to the vehicle. With a key in it every packet that leaves is signed, those of
targets and other companions too, and what comes unsigned, wrongly signed, again or too late is
dropped and counted. Some messages need no signature, RADIO_STATUS for one, which comes from the
telemetry radio itself.
"""

import hashlib
import struct
from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.errors import UsageError
from sim.mock.packet import MAVLINK2, message_id

TICKS_PER_S = 100_000
SIGNED = 0x01
SIGNATURE_BYTES = 13
KEY_BYTES = 32
NEW_STREAM_LATE_TICKS = 60 * TICKS_PER_S
"""A sender not heard before may be a minute behind; one that is known has to rise only."""
_EPOCH = datetime(2015, 1, 1, tzinfo=UTC)


def stamp_at(utc: datetime) -> int:
    """Return the stamp of a time: units of 10 us since 2015."""
    return round((utc - _EPOCH).total_seconds() * TICKS_PER_S)


def load_key(path: Path) -> bytes:
    """Read a key: 32 raw bytes, 64 hexadecimal digits, or a line of text that is hashed.

    The text becomes its SHA-256, as in MAVProxy, Mission Planner and QGroundControl.

    Raises:
        UsageError: If the file cannot be read or is empty.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise UsageError(f"cannot read --signing-key {path}: {error.strerror}") from error
    line = content.strip()
    if not line:
        raise UsageError(f"--signing-key {path} is empty")
    try:
        if len(line) == 2 * KEY_BYTES:
            return bytes.fromhex(line.decode())
    except ValueError:
        pass  # a passphrase of 64 characters
    printable = all(32 <= byte < 127 for byte in content)
    if len(content) == KEY_BYTES and not printable:
        return content
    return hashlib.sha256(line).digest()


@dataclass(slots=True)
class Keyring:
    """The key of the network, the clock of the stamps, and whom it has heard with which stamp."""

    secret: bytes | None = None
    stamp: int = 0
    """The newest stamp sent or heard; time moves it on."""
    unsigned_allowed: Collection[int] = ()
    """Messages that need no signature."""
    refused: Counter[str] = field(default_factory=Counter)
    """Packets dropped, by reason."""
    _heard: dict[tuple[int, int, int], int] = field(default_factory=dict)
    _left_ticks: float = 0.0

    def advance(self, duration_s: float) -> None:
        """Let time pass for the stamps."""
        self._left_ticks += duration_s * TICKS_PER_S
        whole = int(self._left_ticks)
        self._left_ticks -= whole
        self.stamp += whole

    def set_up(self, secret: bytes, stamp: int) -> None:
        """Take the key of SETUP_SIGNING; one of zeros with a stamp of zero ends signing."""
        self.secret = secret if any(secret) or stamp else None
        self.stamp = max(self.stamp, stamp)

    def sign_for_sender(self, packet: bytes) -> bytes:
        """Return somebody else's packet as signed by its sender, if it can be and is not yet."""
        known = mavlink.mavlink_map.get(message_id(packet))
        if self.secret is None or packet[0] != MAVLINK2 or packet[2] & SIGNED or known is None:
            return packet
        return self.sign(packet, known.crc_extra)

    def sign(self, packet: bytes, crc_extra: int) -> bytes:
        """Return an unsigned packet with the signature of this moment.

        Args:
            packet: MAVLink 2.
            crc_extra: What the definition of its message adds to the checksum.
        """
        body = bytearray(packet[:-2])
        body[2] |= SIGNED
        crc = mavlink.x25crc(body[1:] + bytes((crc_extra,)))
        self.stamp += 1
        body += struct.pack("<HB", crc.crc, 0) + self.stamp.to_bytes(6, "little")
        return bytes(body) + self._signature(bytes(body))

    def admits(self, packet: bytes) -> bool:
        """Return whether a valid packet may be looked at; count it where it may not."""
        if self.secret is None:
            return True
        reason = self._objection(packet)
        if reason is not None:
            self.refused[reason] += 1
        return reason is None

    def _objection(self, packet: bytes) -> str | None:
        if packet[0] != MAVLINK2 or not packet[2] & SIGNED:
            return None if message_id(packet) in self.unsigned_allowed else "unsigned"
        if packet[-6:] != self._signature(packet[:-6]):
            return "wrong signature"
        stamp = int.from_bytes(packet[-12:-6], "little")
        stream = packet[-13], packet[5], packet[6]
        before = self._heard.get(stream)
        if before is None and stamp + NEW_STREAM_LATE_TICKS < self.stamp:
            return "old"
        if before is not None and stamp <= before:
            return "replayed"
        self._heard[stream] = stamp
        self.stamp = max(self.stamp, stamp)
        return None

    def _signature(self, body: bytes) -> bytes:
        return hashlib.sha256((self.secret or b"") + body).digest()[:6]
