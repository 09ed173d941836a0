"""A telemetry log (``.tlog``) as frames, whoever wrote it and however it ends.

Every entry is the time in microseconds since 1970, eight bytes big-endian, and one MAVLink frame.
Logs of the field are cut off, have holes, and start before the clock was set: what cannot be read
is counted and stepped over.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from companion.errors import UsageError

_STAMP_BYTES = 8
_V1, _V2 = 0xFE, 0xFD
_MAGIC = re.compile(rb"[\xfd\xfe]")
_SIGNATURE_BYTES = 13
_EARLIEST_US, _LATEST_US = 0, 4_102_444_800_000_000  # 1970 to 2100: some clocks were never set
_STEP_US = 600_000_000  # a jump of the clock, not a silence of the link
_BACK_US = 2_000_000  # a reader who was away stamps what waited for it with an earlier time,
_BEHIND = 200  # but not this many entries in a row: then the clock was set back
_OTHERS = {
    b"ULog": "a ULog of PX4: the vehicle's own log, not what crossed the link",
    b"\xa3\x95": "a dataflash log of ArduPilot: the vehicle's own log, not what crossed the link",
    b"RRF": "a Rerun recording: name it .rrd",
    b"\x1f\x8b": "compressed: unpack it first",
    b"PK\x03\x04": "compressed: unpack it first",
    b"\xfd7zXZ": "compressed: unpack it first",
}
_RAW_FRAMES = 3  # that follow each other without a time between them


class Frame(NamedTuple):
    """One MAVLink frame of the log, its fields not yet decoded."""

    time_s: float
    """Since the first frame; never less than that of the frame before."""
    system_id: int
    component_id: int
    sequence: int
    message_id: int
    data: bytes


@dataclass
class LogFile:
    """The bytes of a log, and what was met on the way through them."""

    path: Path
    data: bytes
    start_utc_us: int = 0
    bad_bytes: int = 0
    """Bytes that belong to no entry, of the last pass."""
    clock_steps: list[tuple[float, float]] = field(default_factory=list)
    """When the writer's clock was set, and by how much, seconds; of the last pass."""

    def frames(self) -> Iterator[Frame]:
        """Yield the frames in order; one pass."""
        self.bad_bytes, self.clock_steps = 0, []
        data, size = self.data, len(self.data)
        at, last_us, offset_us, behind, set_us = 0, None, 0, 0, 0
        while at + _STAMP_BYTES + 2 < size:
            end = _entry_end(data, at, size)
            utc_us = int.from_bytes(data[at : at + _STAMP_BYTES], "big")
            if end is None or not _EARLIEST_US <= utc_us < _LATEST_US:
                at = self._skip(at)
                continue
            if last_us is None:
                self.start_utc_us = utc_us
            step_us = 0 if last_us is None else utc_us - last_us
            behind = behind + 1 if step_us < -_BACK_US else 0
            set_us = min(set_us, step_us) if behind else step_us
            if last_us is not None and (abs(step_us) >= _STEP_US or behind > _BEHIND):
                at_s = (last_us + offset_us - self.start_utc_us) * 1e-6
                self.clock_steps.append((at_s, set_us * 1e-6))
                offset_us -= step_us
                last_us, behind = utc_us, 0
            last_us = utc_us if last_us is None else max(last_us, utc_us)
            time_s = max(0.0, (last_us + offset_us - self.start_utc_us) * 1e-6)
            yield _frame(time_s, data[at + _STAMP_BYTES : end])
            at = end
        self.bad_bytes += size - at

    def _skip(self, at: int) -> int:
        """Return where the next entry may begin."""
        found = _MAGIC.search(self.data, at + _STAMP_BYTES + 1)
        after = len(self.data) if found is None else found.start() - _STAMP_BYTES
        self.bad_bytes += after - at
        return after


def open_log(path: Path) -> LogFile:
    """Read a telemetry log.

    Raises:
        UsageError: If it cannot be read, or holds no MAVLink.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror}") from error
    if not data:
        raise UsageError(f"{path} is empty")
    for magic, what in _OTHERS.items():
        if data.startswith(magic):
            raise UsageError(f"{path} is {what}")
    if _is_raw(data):
        raise UsageError(
            f"{path} is a raw stream of MAVLink without times: give the telemetry log (.tlog)"
        )
    log = LogFile(path, data)
    if next(log.frames(), None) is None:
        raise UsageError(f"{path} is no telemetry log: there is no MAVLink in it")
    return log


def _is_raw(data: bytes) -> bool:
    """Return whether frames begin at once, and follow each other without times."""
    at = 0
    for _ in range(_RAW_FRAMES):
        end = _frame_end(data, at)
        if end is None or end > len(data):
            return False
        at = end
    return True


def _frame_end(data: bytes, begin: int) -> int | None:
    """Return where the frame at ``begin`` ends by its own word, ``None`` if there is none."""
    head = data[begin : begin + 3]
    if len(head) < 3:
        return None
    magic, length, flags = head
    if magic == _V2:
        signed = _SIGNATURE_BYTES if flags & 1 else 0
        return None if flags & ~1 else begin + length + 12 + signed
    return begin + length + 8 if magic == _V1 else None


def _entry_end(data: bytes, at: int, size: int) -> int | None:
    """Return the end of the entry at ``at``, ``None`` if there is none.

    An entry is believed where another follows it or the file ends.
    """
    end = _frame_end(data, at + _STAMP_BYTES)
    if end is None or end > size:
        return None
    following = end + _STAMP_BYTES
    return end if following >= size or data[following] in (_V1, _V2) else None


def _frame(time_s: float, data: bytes) -> Frame:
    if data[0] == _V2:
        return Frame(time_s, data[5], data[6], data[4], int.from_bytes(data[7:10], "little"), data)
    return Frame(time_s, data[3], data[4], data[2], data[5], data)
