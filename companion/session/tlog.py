"""``flight.tlog``: the telemetry log that every ground station reads.

Each entry is the time in microseconds since 1970, eight bytes big-endian, and one MAVLink frame.
"""

from typing import BinaryIO


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
