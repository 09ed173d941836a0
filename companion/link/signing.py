"""MAVLink 2 signing: who may speak on the link, decided by a key that both ends hold.

With a key, every frame of anybody must be signed with it, targets and ground stations included:
what is not is dropped and counted before anything looks at it. One exception, as the guide has
it: RADIO_STATUS, which a telemetry radio makes itself, and which changes no state here.
Wire format: https://mavlink.io/en/guide/message_signing.html
"""

import hashlib
import hmac
import os
import re
import stat
from dataclasses import dataclass, field
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path

from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.errors import RefusedError, UsageError
from companion.link.codec import reheaded

_KEY_BYTES = 32
_MAX_FILE_BYTES = 1024
_HEX_KEY = re.compile(rb"[0-9a-fA-F]{64}")

_EPOCH = datetime(2015, 1, 1, tzinfo=UTC)
_TICKS_PER_S = 100_000
_LAST_STAMP = (1 << 48) - 1
_OLD_TICKS = 60 * _TICKS_PER_S
"""How far behind our clock a stamp may be."""

_MAGIC_V2 = 0xFD
_SIGNED = 0x01
_SIGNATURE_BYTES = 6
_TRAILER_BYTES = 13
"""Link id, stamp, signature."""


@dataclass(frozen=True, slots=True)
class SigningKey:
    """A key, and how it was written down."""

    secret: bytes = field(repr=False)
    form: str
    """For people: what the key file held."""


def load_key(path: Path) -> SigningKey:
    """Read a key file: 32 raw bytes, 64 hexadecimal digits, or one line of passphrase.

    A passphrase becomes its SHA-256, as in MAVProxy, Mission Planner and QGroundControl. 32
    bytes that are all printable are a passphrase: a random key never is.

    Raises:
        UsageError: If the file cannot be read.
        RefusedError: If others may read it, or it holds no key.
    """
    try:
        with path.open("rb") as file:
            mode = os.fstat(file.fileno()).st_mode
            content = file.read(_MAX_FILE_BYTES + 1)
    except OSError as error:
        raise UsageError(f"cannot read --signing-key {path}: {error.strerror}") from error
    if mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise RefusedError(
            f"--signing-key {path} is open to others (mode {stat.S_IMODE(mode):03o}); whoever "
            f"reads it can fly the vehicle: chmod 600 {path}"
        )
    line = content.removesuffix(b"\n").removesuffix(b"\r")
    if _HEX_KEY.fullmatch(line):
        return SigningKey(bytes.fromhex(line.decode("ascii")), "64 hexadecimal digits")
    text = _text(line)
    if len(content) == _KEY_BYTES and text is None:
        return SigningKey(content, "32 raw bytes")
    if not text or len(content) > _MAX_FILE_BYTES:
        raise RefusedError(
            f"--signing-key {path} holds no key: it must be 32 raw bytes, 64 hexadecimal digits, "
            "or one line of passphrase"
        )
    return SigningKey(hashlib.sha256(line).digest(), "a passphrase, hashed with SHA-256")


def stamp_at(utc: datetime) -> int:
    """Return the stamp of a time: units of 10 us since 2015."""
    return max(0, round((utc - _EPOCH).total_seconds() * _TICKS_PER_S))


class Fault(StrEnum):
    """Why a packet was dropped."""

    UNSIGNED = "not signed"
    WRONG_KEY = "signed with another key"
    REPLAYED = "replayed or out of order"
    OLD = "stamped over a minute ago"


class Signing:
    """Signs what leaves and judges what comes, for one link.

    Stamps come from the wall clock once, at the start, and rise with the monotonic clock from
    then on, so no step of the wall clock moves them back. A later stamp of anybody who holds the
    key moves them forward: a computer that lost its clock is put right by its vehicle.
    """

    def __init__(self, key: SigningKey, *, stamp: int, now_s: float, link_id: int = 0) -> None:
        """Start with ``key`` at ``stamp`` (see ``stamp_at``), which is monotonic ``now_s``."""
        self._secret = key.secret
        self._link_id = link_id
        self._base = stamp
        self._base_s = now_s
        self._newest_sent = 0
        self._newest_heard: dict[tuple[int, int, int], int] = {}
        self.refused = dict.fromkeys(Fault, 0)
        """Packets dropped, by reason."""

    def sign(self, frame: bytes, now_s: float) -> bytes:
        """Return an unsigned MAVLink 2 frame as a signed one, with the next stamp."""
        self._newest_sent = min(max(self._newest_sent + 1, self._stamp(now_s)), _LAST_STAMP)
        body = reheaded(frame, sequence=frame[4], incompatible=frame[2] | _SIGNED)
        body += bytes((self._link_id,)) + self._newest_sent.to_bytes(6, "little")
        return body + self._signature(body)

    def admits(self, frame: bytes, now_s: float) -> bool:
        """Judge a whole packet, whose checksum fits; count it where it is dropped."""
        fault = self._fault(frame, now_s)
        if fault is None:
            return True
        self.refused[fault] += 1
        return False

    def refused_in_words(self) -> str:
        """Return what was dropped and why, ``3 not signed, 1 signed with another key``."""
        return ", ".join(f"{count} {fault}" for fault, count in self.refused.items() if count)

    def _fault(self, frame: bytes, now_s: float) -> Fault | None:
        if frame[0] != _MAGIC_V2 or not frame[2] & _SIGNED:
            return None if _is_radio_status(frame) else Fault.UNSIGNED
        body, signature = frame[:-_SIGNATURE_BYTES], frame[-_SIGNATURE_BYTES:]
        if not hmac.compare_digest(signature, self._signature(body)):
            return Fault.WRONG_KEY
        stamp = int.from_bytes(body[-6:], "little")
        stream = (frame[-_TRAILER_BYTES], frame[5], frame[6])
        if stamp <= self._newest_heard.get(stream, -1):
            return Fault.REPLAYED
        ours = self._stamp(now_s)
        if stamp + _OLD_TICKS < ours:
            return Fault.OLD
        self._newest_heard[stream] = stamp
        self._base += max(0, stamp - ours)
        return None

    def _signature(self, body: bytes) -> bytes:
        return hashlib.sha256(self._secret + body).digest()[:_SIGNATURE_BYTES]

    def _stamp(self, now_s: float) -> int:
        return self._base + round((now_s - self._base_s) * _TICKS_PER_S)


def _is_radio_status(frame: bytes) -> bool:
    id_at = slice(7, 10) if frame[0] == _MAGIC_V2 else slice(5, 6)
    radio_status: int = dialect.MAVLINK_MSG_ID_RADIO_STATUS
    return int.from_bytes(frame[id_at], "little") == radio_status


def _text(line: bytes) -> str | None:
    """Return what is one line of printable text, ``None`` if it is not."""
    try:
        text = line.decode("utf-8")
    except UnicodeDecodeError:
        return None
    return text if text.isprintable() else None
