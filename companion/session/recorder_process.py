"""The recorder: ``python -m companion.session.recorder_process FOLDER off|serve|spawn``.

Reads records from standard input until the flying process closes it or dies, and writes the
session folder. Whatever goes wrong with one file, the others are written and the pipe is drained:
flight must not notice. Lines on standard output are for the flying process's log.
"""

import contextlib
import os
import select
import signal
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol

from companion.clock import now_s
from companion.errors import CompanionError
from companion.session.folder import RECORDING, TLOG
from companion.session.records import Raw, Record, RecordReader, SessionStart
from companion.session.tlog import TlogWriter
from companion.session.viewer import has_display, open_viewer, optimize

Say = Callable[[str], None]

_PERIOD_S = 0.2  # between flushes; the live view is that far behind
_SYNC_S = 5.0  # a vehicle that loses power loses that much of its tlog
_READ_BYTES = 1 << 18
_NICENESS = 10  # the control loop comes first


class Output(Protocol):
    """One file of the session folder, or the live view."""

    name: str

    def write(self, record: Record) -> None:
        """Take one record; may keep it until ``flush``."""
        ...

    def flush(self, now_s: float) -> None:
        """Write what is due; called several times a second."""
        ...

    def close(self) -> None:
        """Write the rest and finish the file."""
        ...


class TlogOutput:
    """``flight.tlog``."""

    name = TLOG

    def __init__(self, path: Path) -> None:
        """Create the file.

        Raises:
            OSError: If the folder cannot be written to.
        """
        self._file = path.open("wb")
        self._writer = TlogWriter(self._file, 0)
        self._synced_s = 0.0

    def write(self, record: Record) -> None:
        """Take one record; only the raw frames matter here."""
        if isinstance(record, SessionStart):
            self._writer = TlogWriter(self._file, record.start_utc_us)
        elif isinstance(record, Raw):
            self._writer.write(record.time_s, record.data)

    def flush(self, now_s: float) -> None:
        """Hand what there is to the system, and now and then to the disk."""
        self._file.flush()
        if now_s - self._synced_s >= _SYNC_S:
            os.fsync(self._file.fileno())
            self._synced_s = now_s

    def close(self) -> None:
        """Finish the file."""
        self._file.close()


class Outputs:
    """All outputs of a session; one that fails is given up and said so, the others go on."""

    def __init__(self, outputs: Sequence[Output], say: Say) -> None:
        self._outputs = list(outputs)
        self._say = say

    def write(self, record: Record) -> None:
        """Give one record to every output."""
        self._each(lambda output: output.write(record))

    def flush(self, now_s: float) -> None:
        """Let every output write what is due."""
        self._each(lambda output: output.flush(now_s))

    def close(self) -> None:
        """Finish every file."""
        self._each(lambda output: output.close())

    def _each(self, act: Callable[[Output], None]) -> None:
        for output in list(self._outputs):
            try:
                act(output)
            except Exception as error:  # whatever it is, the other files must be written
                self._outputs.remove(output)
                self._say(f"{output.name} is incomplete: {error}")


def drain(descriptor: int, outputs: Outputs) -> None:
    """Read records from ``descriptor`` until its end and hand them to ``outputs``."""
    reader = RecordReader()
    due_s = 0.0
    while True:
        readable, _, _ = select.select([descriptor], [], [], _PERIOD_S)
        if readable:
            data = os.read(descriptor, _READ_BYTES)
            if not data:
                return
            for record in reader.feed(data):
                outputs.write(record)
        if now_s() >= due_s:
            outputs.flush(now_s())
            due_s = now_s() + _PERIOD_S


def _say(text: str) -> None:
    """Tell the flying process, if it still listens."""
    with contextlib.suppress(OSError):
        os.write(sys.stdout.fileno(), f"{text}\n".encode())


def _open_outputs(folder: Path, live: str) -> list[Output]:
    """Open what can be opened and say what cannot."""
    outputs: list[Output] = []
    try:
        outputs.append(TlogOutput(folder / TLOG))
    except OSError as error:
        _say(f"no {TLOG}: {error}")
    try:
        from companion.session.streams import file_output, live_output
    except ImportError:
        _say(f'no {RECORDING}: Rerun is not installed (pip install "rerun-sdk==0.41.*")')
        return outputs
    outputs.append(file_output(folder))
    if live != "off":
        outputs.append(live_output(_announce_and_open if live == "spawn" else _announce))
    return outputs


def _announce(address: str) -> None:
    _say(f"live view: rerun --connect {address}")


def _announce_and_open(address: str) -> None:
    _announce(address)
    if not has_display():
        _say("no viewer opened: there is no display here")
        return
    try:
        open_viewer("--connect", address)
    except CompanionError as error:
        _say(f"no viewer opened: {error}")


def main() -> None:
    """Record one session."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # the end of the pipe is the only end
    os.nice(_NICENESS)
    os.set_blocking(sys.stdout.fileno(), False)
    folder, live = Path(sys.argv[1]), sys.argv[2]
    outputs = Outputs(_open_outputs(folder, live), _say)
    drain(sys.stdin.fileno(), outputs)
    outputs.close()
    recording, rewritten = folder / RECORDING, folder / f"{RECORDING}.part"
    if recording.exists() and optimize(recording, rewritten):
        rewritten.replace(recording)


if __name__ == "__main__":
    main()
