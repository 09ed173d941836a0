"""Where and with what a report was made."""

import importlib.metadata
import os
import platform
from pathlib import Path

from companion.clock import utc_now

_LIBRARIES = ("numpy", "torch", "shapely", "matplotlib", "onnxruntime")


def describe_machine() -> str:
    """Return processor, cores and system in one line."""
    return (
        f"{_processor()}, {os.cpu_count()} cores, {platform.system()} {platform.machine()}, "
        f"no GPU used"
    )


def library_versions() -> dict[str, str]:
    """Return the versions of Python and of the libraries that decide numbers."""
    versions = {"Python": platform.python_version()}
    for name in _LIBRARIES:
        versions[name] = importlib.metadata.version(name)
    return versions


def utc_text() -> str:
    """Return the date and time now, to the minute."""
    return f"{utc_now():%Y-%m-%d %H:%M} UTC"


def _processor() -> str:
    """Return the processor's name as Linux tells it, elsewhere as Python does."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    for line in lines:
        key, _, value = line.partition(":")
        if key.strip() == "model name":
            return value.strip()
    return platform.processor() or platform.machine()
