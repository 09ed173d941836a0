"""The state of the computer we run on, for ONBOARD_COMPUTER_STATUS.

PX4 warns the pilot of a hot companion (COM_CC_TEMP_WARN) and ground stations show the rest. Only
files that the kernel makes up are read, so that no disk can hold the control loop.
"""

from pathlib import Path
from typing import NamedTuple

MAX_CORES = 8
UNKNOWN_PERCENT = 255
UNKNOWN_CELSIUS = 127
UNKNOWN_MIB = 0xFFFFFFFF
_PROC, _SYS = Path("/proc"), Path("/sys/class/thermal")
_KIB_PER_MIB = 1024


class Computer(NamedTuple):
    """Load, heat and memory, in the units of ONBOARD_COMPUTER_STATUS."""

    core_percent: tuple[int, ...]
    """Load of each core since the last look, ``MAX_CORES`` long; ``UNKNOWN_PERCENT`` behind."""
    celsius: int
    ram_used_mib: int
    ram_total_mib: int


class ComputerProbe:
    """Reads the state; loads are those since the last reading."""

    def __init__(self, proc: Path = _PROC, thermal: Path = _SYS) -> None:
        """Read from the kernel's own file systems, or from what a test puts in their place."""
        self._proc, self._thermal = proc, thermal
        self._before: dict[str, tuple[int, int]] = {}

    def read(self) -> Computer:
        """Return the state now; what cannot be read is unknown, nothing raises."""
        used_mib, total_mib = self._memory_mib()
        return Computer(self._core_percent(), self._celsius(), used_mib, total_mib)

    def _core_percent(self) -> tuple[int, ...]:
        percent: list[int] = []
        for line in _lines(self._proc / "stat"):
            name, *ticks = line.split()
            if name == "cpu" or not name.startswith("cpu"):
                continue
            counts = [int(tick) for tick in ticks]
            busy, total = sum(counts) - sum(counts[3:5]), sum(counts)  # idle and iowait are not
            busy_before, total_before = self._before.get(name, (0, 0))
            self._before[name] = (busy, total)
            passed = max(1, total - total_before)
            percent.append(max(0, min(100, round(100 * (busy - busy_before) / passed))))
        return tuple((percent + [UNKNOWN_PERCENT] * MAX_CORES)[:MAX_CORES])

    def _celsius(self) -> int:
        """Return the hottest zone's temperature."""
        hottest: int | None = None
        for zone in sorted(self._thermal.glob("thermal_zone*/temp")):
            for line in _lines(zone):
                celsius = max(-126, min(126, round(int(line) / 1000)))
                hottest = celsius if hottest is None else max(hottest, celsius)
        return UNKNOWN_CELSIUS if hottest is None else hottest

    def _memory_mib(self) -> tuple[int, int]:
        known: dict[str, int] = {}
        for line in _lines(self._proc / "meminfo"):
            name, _, value = line.partition(":")
            if name in ("MemTotal", "MemAvailable"):
                known[name] = int(value.split()[0]) // _KIB_PER_MIB
        if len(known) < 2:
            return UNKNOWN_MIB, UNKNOWN_MIB
        return known["MemTotal"] - known["MemAvailable"], known["MemTotal"]


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text(encoding="ascii", errors="replace").splitlines()
    except OSError:
        return []
