"""Where and with what a report was made."""

import importlib.metadata
import os
import platform
from pathlib import Path

import torch

from companion.clock import utc_now
from training.presets import DeviceName

_LIBRARIES = ("numpy", "torch", "shapely", "matplotlib", "onnxruntime")


def describe_machine(device: DeviceName = "cpu") -> str:
    """Return processor, cores, system and what the networks run on, in one line."""
    gpu = "no GPU used" if device == "cpu" else torch.cuda.get_device_name()
    return (
        f"{_processor()}, {os.cpu_count()} cores, {platform.system()} {platform.machine()}, "
        f"torch {torch.__version__}, {gpu}"
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
