"""The session folder: its name, the names of its files, and the JSON in it.

2026-11-22T14-03-07Z/
    session.rrd     everything that was decided, for Rerun
    flight.tlog     the raw MAVLink, both directions
    inputs.bin      what the program was told, byte by byte and tick by tick, for ``replay``
    summary.json    how it ended
    config.json     what it was told
"""

import os
from datetime import datetime
from pathlib import Path
from typing import Any

import msgspec

from companion.errors import UsageError
from companion.session.summary import Summary

RECORDING = "session.rrd"
TLOG = "flight.tlog"
INPUTS = "inputs.bin"
SUMMARY = "summary.json"
CONFIG = "config.json"


def create_session_folder(parent: Path, start_utc: datetime) -> Path:
    """Make a new folder named after the start of the session and return its path.

    Raises:
        UsageError: If ``parent`` cannot be written to.
    """
    stamp = f"{start_utc:%Y-%m-%dT%H-%M-%SZ}"
    for attempt in range(1, 1000):
        folder = parent / (stamp if attempt == 1 else f"{stamp}-{attempt}")
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            if not parent.is_dir():
                raise UsageError(f"--record {parent} is a file, give a folder") from None
        except OSError as error:
            raise UsageError(f"cannot write to --record {parent}: {error.strerror}") from error
        else:
            return folder
    raise UsageError(f"{parent} is full of sessions that start at {stamp}")


def write_summary(folder: Path, summary: Summary) -> None:
    """Write ``summary.json``, whole or not at all.

    Raises:
        OSError: If the disk is full or cannot be written to.
    """
    _write_json(folder / SUMMARY, summary)


def write_config(folder: Path, config: dict[str, Any]) -> None:
    """Write ``config.json``, whole or not at all; values that JSON lacks become text.

    Raises:
        OSError: If the disk is full or cannot be written to.
    """
    _write_json(folder / CONFIG, config)


def _write_json(path: Path, value: Any) -> None:
    """Write beside the file and rename: a reader or a crash never sees half of it."""
    text = msgspec.json.format(msgspec.json.encode(value, enc_hook=str), indent=2)
    temporary = path.with_suffix(path.suffix + ".part")
    with temporary.open("wb") as file:
        file.write(text + b"\n")
        file.flush()
        os.fsync(file.fileno())
    temporary.replace(path)
