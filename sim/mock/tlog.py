"""Telemetry logs: big-endian microseconds of wall clock before each MAVLink frame."""

import lzma
import struct
from collections.abc import Iterator
from pathlib import Path

from sim.mock.packet import MAVLINK2

_STAMP = struct.Struct(">Q")
_STARTS = {MAVLINK2: 12, 0xFE: 8}
"""First byte of a frame, and what it is long besides its payload."""
_SIGNATURE = 13


def read_frames(path: Path) -> Iterator[tuple[float, bytes]]:
    """Yield (seconds, frame) of a log, oldest first; one packed with xz is unpacked.

    Raises:
        OSError: If it cannot be read.
        ValueError: If it is no telemetry log; one that is cut off in a frame just ends.
    """
    data = path.read_bytes()
    if path.suffix == ".xz":
        try:
            data = lzma.decompress(data)
        except lzma.LZMAError as error:
            raise ValueError(f"{path} cannot be unpacked: {error}") from error
    position = 0
    while position + _STAMP.size + 3 <= len(data):
        (stamp_us,) = _STAMP.unpack_from(data, position)
        start = position + _STAMP.size
        overhead = _STARTS.get(data[start])
        if overhead is None:
            raise ValueError(f"{path} is no telemetry log: no MAVLink frame at byte {start}")
        signed = data[start] == MAVLINK2 and data[start + 2] & 1
        position = start + overhead + data[start + 1] + (_SIGNATURE if signed else 0)
        if position <= len(data):
            yield stamp_us * 1e-6, data[start:position]
