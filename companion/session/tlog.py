"""``flight.tlog``: the telemetry log that every ground station reads.

Each entry is the time in microseconds since 1970, eight bytes big-endian, and one MAVLink frame.
"""

from typing import BinaryIO

_STAMP_BYTES = 8
_HEAD_BYTES = 3
_MAGIC_V1 = 0xFE
_SIGNATURE_BYTES = 13


class TlogWriter:
    """Write the frames of both directions to one telemetry log."""

    def __init__(self, file: BinaryIO, start_utc_us: int) -> None:
        """Write to ``file``, which stays the caller's to close.

        Args:
            file: Open for binary writing.
            start_utc_us: Wall-clock time at ``time_s == 0``, microseconds since 1970.
        """
        self._file = file
        self._start_utc_us = start_utc_us

    def write(self, time_s: float, frame: bytes) -> None:
        """Add one frame; readers expect exactly one for each time.

        Raises:
            OSError: If the disk is full.
        """
        utc_us = self._start_utc_us + round(time_s * 1e6)
        self._file.write(utc_us.to_bytes(8, "big") + frame)


def read_tlog(data: bytes) -> list[tuple[int, bytes]]:
    """Return ``(utc_us, frame)`` of every frame; one that is cut off at the end is left out."""
    entries: list[tuple[int, bytes]] = []
    at = 0
    while at + _STAMP_BYTES + _HEAD_BYTES <= len(data):
        begin = at + _STAMP_BYTES
        end = begin + _frame_bytes(data[begin : begin + _HEAD_BYTES])
        if end > len(data):
            break
        entries.append((int.from_bytes(data[at:begin], "big"), data[begin:end]))
        at = end
    return entries


def _frame_bytes(head: bytes) -> int:
    """Return the size of the frame that begins with magic, length and flags."""
    if head[0] == _MAGIC_V1:
        return head[1] + 8
    return head[1] + 12 + (_SIGNATURE_BYTES if head[2] & 1 else 0)
