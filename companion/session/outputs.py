"""What the recorder process writes, and what keeps one output from harming another."""

import os
import queue
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol

from companion.session.folder import TLOG
from companion.session.records import Raw, Record, SessionStart
from companion.session.tlog import TlogWriter

_SYNC_S = 5.0  # a vehicle that loses power loses that much
_WAITING = 50_000  # records; more than a quarter of an hour of ticks
_FINISH_S = 10.0


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


class Sync:
    """Gets a file onto the disk now and then."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._due_s = 0.0

    def __call__(self, now_s: float) -> None:
        """Wait for the disk if it is time to; what was handed to the system is safe then.

        Raises:
            OSError: If the disk fails.
        """
        if now_s < self._due_s:
            return
        self._due_s = now_s + _SYNC_S
        descriptor = os.open(self._path, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


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
        self._sync = Sync(path)

    def write(self, record: Record) -> None:
        """Take one record; only the raw frames matter here."""
        if isinstance(record, SessionStart):
            self._writer = TlogWriter(self._file, record.start_utc_us)
        elif isinstance(record, Raw):
            self._writer.write(record.time_s, record.data)

    def flush(self, now_s: float) -> None:
        """Hand what there is to the system, and now and then to the disk."""
        self._file.flush()
        self._sync(now_s)

    def close(self) -> None:
        """Finish the file."""
        self._file.close()


class Background:
    """Runs an output on a thread of its own: Rerun may block for ever, on a full disk say."""

    def __init__(self, output: Output) -> None:
        self.name = output.name
        self._output = output
        self._error: Exception | None = None
        self._jobs: queue.Queue[Callable[[], None] | None] = queue.Queue(_WAITING)
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def write(self, record: Record) -> None:
        """Pass one record on.

        Raises:
            RuntimeError: If the output has failed, or is so far behind that it must be stuck.
        """
        self._do(lambda: self._output.write(record))

    def flush(self, now_s: float) -> None:
        """Pass the time on; raises as ``write`` does."""
        self._do(lambda: self._output.flush(now_s))

    def close(self) -> None:
        """Finish, or give up after a while; raises as ``write`` does."""
        self._do(self._output.close)
        self._jobs.put(None, timeout=_FINISH_S)
        self._thread.join(_FINISH_S)
        if self._error is not None or self._thread.is_alive():
            raise RuntimeError(self._error or "it is stuck; is the disk full?")

    def _do(self, job: Callable[[], None]) -> None:
        if self._error is not None:
            raise RuntimeError(self._error)
        try:
            self._jobs.put_nowait(job)
        except queue.Full:
            raise RuntimeError("it is stuck; is the disk full?") from None

    def _work(self) -> None:
        try:
            while (job := self._jobs.get()) is not None:
                job()
        except Exception as error:
            self._error = error


class Outputs:
    """All outputs of a session; one that fails is given up and said so, the others go on."""

    def __init__(self, outputs: Sequence[Output], say: Callable[[str], None]) -> None:
        self._outputs = list(outputs)
        self._failed: set[str] = set()
        self._say = say

    def write(self, record: Record) -> None:
        """Give one record to every output."""
        self._each(lambda output: output.write(record))

    def flush(self, now_s: float) -> None:
        """Let every output write what is due."""
        self._each(lambda output: output.flush(now_s))

    def close(self) -> set[str]:
        """Finish every file and return the names of those that are incomplete."""
        self._each(lambda output: output.close())
        return self._failed

    def _each(self, act: Callable[[Output], None]) -> None:
        for output in list(self._outputs):
            try:
                act(output)
            except Exception as error:  # whatever it is, the other files must be written
                self._outputs.remove(output)
                self._failed.add(output.name)
                self._say(f"{output.name} is incomplete: {error}")
