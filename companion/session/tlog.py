"""``flight.tlog``: the telemetry log that every ground station reads.

Each entry is the time in microseconds since 1970, eight bytes big-endian, and one MAVLink
frame. Readers take exactly one frame for each time, so portions of bytes from the link are cut
into frames first.
"""

from typing import BinaryIO

_MAGIC_V1, _MAGIC_V2 = 0xFE, 0xFD
_OVERHEAD_V1 = 8  # magic, length, sequence, system, component, message, checksum
_OVERHEAD_V2 = 12  # the same with two flag bytes and a three-byte message id
_SIGNATURE_BYTES = 13
_SIGNED_FLAG = 0x01  # MAVLINK_IFLAG_SIGNED
_FLAGS_AT = 2


class FrameSplitter:
    """Cut bytes into MAVLink frames by their length fields; bytes between frames are skipped."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[bytes]:
        """Return the frames that ``data`` completes; the beginning of the next is kept."""
        self._buffer += data
        frames = []
        start = 0
        while (start := self._next_magic(start)) < len(self._buffer):
            length = self._frame_length(start)
            if length is None or start + length > len(self._buffer):
                break
            frames.append(bytes(self._buffer[start : start + length]))
            start += length
        del self._buffer[:start]
        return frames

    def _next_magic(self, start: int) -> int:
        while start < len(self._buffer) and self._buffer[start] not in (_MAGIC_V1, _MAGIC_V2):
            start += 1
        return start

    def _frame_length(self, start: int) -> int | None:
        """Return the length of the frame at ``start``, ``None`` if its header is incomplete."""
        header = self._buffer[start : start + _FLAGS_AT + 1]
        if len(header) <= _FLAGS_AT:
            return None
        if header[0] == _MAGIC_V1:
            return header[1] + _OVERHEAD_V1
        signed = bool(header[_FLAGS_AT] & _SIGNED_FLAG)
        return header[1] + _OVERHEAD_V2 + (_SIGNATURE_BYTES if signed else 0)


class TlogWriter:
    """Write both directions of a link to one telemetry log."""

    def __init__(self, file: BinaryIO) -> None:
        """Write to ``file``, which stays the caller's to close."""
        self._file = file
        self._splitters = {True: FrameSplitter(), False: FrameSplitter()}

    def write(self, data: bytes, *, sent: bool, utc_us: int) -> None:
        """Add the frames that ``data`` completes, stamped ``utc_us``.

        Raises:
            OSError: If the disk is full.
        """
        for frame in self._splitters[sent].feed(data):
            self._file.write(utc_us.to_bytes(8, "big") + frame)
