"""The flying process's end of the recorder: hands records over and never waits.

The other end is ``python -m companion.session.recorder_process``. Only a pipe joins the two:
the recorder may be slow, stopped or dead, and the control loop does not notice. Rerun is not
imported here.
"""

import contextlib
import os
import select
import subprocess
import sys
from collections import deque
from pathlib import Path
from typing import IO, Literal

from companion.clock import now_s
from companion.session.records import Inputs, Raw, Record, encode_record

LiveView = Literal["off", "serve", "spawn"]

_PIPE_BYTES = 1 << 20
_BACKLOG_BYTES = 8 << 20  # minutes of a busy link
_PORTION_BYTES = 1 << 16
"""Handed over by one system call: all records of a turn of the loop."""


class Recorder:
    """Feeds records to the recorder process through a bounded backlog that drops the oldest."""

    def __init__(
        self, folder: Path, *, live: LiveView = "off", backlog_bytes: int = _BACKLOG_BYTES
    ) -> None:
        """Start the recorder process.

        Args:
            folder: The session folder; it exists.
            live: Host a live view on loopback (``serve``), and open a viewer on it (``spawn``).
            backlog_bytes: How much to keep while the process does not read.
        """
        self.alive = True
        """Whether the recorder process takes records; once ``False``, it stays so."""
        self.dropped = 0
        """Records lost: the oldest, when the backlog was full, and any after its death."""
        self._backlog: deque[bytes] = deque()
        self._backlog_bytes = 0
        self._backlog_limit = backlog_bytes
        self._begun = b""  # rest of a portion of which the pipe has taken a part
        self._begun_records = 0
        self._said = b""
        self._process = subprocess.Popen(
            [sys.executable, "-m", f"{__package__}.recorder_process", str(folder), live],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            bufsize=0,
            env={"RUST_LOG": "error", **os.environ},  # Rerun's own warnings are not for pilots
            start_new_session=True,  # Ctrl-C on the terminal is for the flying process
        )
        self._inlet = _end(self._process.stdin)
        self._outlet = _end(self._process.stdout)
        _widen(self._inlet.fileno())

    @property
    def process_id(self) -> int:
        """The recorder process, to find it among others."""
        return self._process.pid

    def put(self, record: Record) -> None:
        """Hand over one record; returns at once and never raises.

        What the link says goes with the next record of another kind: once a turn of the loop, after
        the setpoint has left.
        """
        if not self.alive:
            self.dropped += 1
            return
        try:
            data = encode_record(record)
        except (TypeError, ValueError, OverflowError):
            self.dropped += 1
            return
        self._backlog.append(data)
        self._backlog_bytes += len(data)
        if not isinstance(record, Raw | Inputs):
            self._drain()
        while self._backlog_bytes > self._backlog_limit:
            self._backlog_bytes -= len(self._backlog.popleft())
            self.dropped += 1

    def take_messages(self) -> list[str]:
        """Return what the recorder process has said since the last call, a line each."""
        self._listen()
        *lines, self._said = self._said.split(b"\n")
        return [line.decode(errors="replace") for line in lines]

    def close(self, timeout_s: float) -> bool:
        """Hand over what is left, end the stream and wait for the files to be finished.

        Returns:
            Whether the recorder process finished in time. If not it goes on by itself and ends
            when it has written what it was given.
        """
        deadline_s = now_s() + timeout_s
        while self.alive and (self._begun or self._backlog):
            _, writable, _ = select.select([], [self._inlet], [], max(0.0, deadline_s - now_s()))
            if not writable:
                break
            self._drain()
        self._give_up()
        self._inlet.close()
        try:
            finished = self._process.wait(max(0.0, deadline_s - now_s())) == 0
        except subprocess.TimeoutExpired:
            self._process.returncode = 0  # it is left to itself: no warning about it later
            finished = False
        self._listen()
        self._outlet.close()
        return finished

    def _drain(self) -> None:
        """Write until the pipe is full or the backlog empty."""
        try:
            while self._begun or self._backlog:
                if not self._begun:
                    self._begin_portion()
                self._begun = self._begun[os.write(self._inlet.fileno(), self._begun) :]
        except BlockingIOError:
            return
        except OSError:  # the process is gone: EPIPE
            self._give_up()

    def _begin_portion(self) -> None:
        """Take the oldest records of the backlog together."""
        portion: list[bytes] = []
        size = 0
        while self._backlog and size < _PORTION_BYTES:
            portion.append(self._backlog.popleft())
            size += len(portion[-1])
        self._begun, self._begun_records = b"".join(portion), len(portion)
        self._backlog_bytes -= size

    def _give_up(self) -> None:
        """Take no more records; what was not written is lost."""
        self.alive = False
        self.dropped += len(self._backlog) + (self._begun_records if self._begun else 0)
        self._backlog.clear()
        self._backlog_bytes = 0
        self._begun = b""

    def _listen(self) -> None:
        """Read what the process has said so far."""
        if self._outlet.closed:
            return
        with contextlib.suppress(BlockingIOError):
            while data := os.read(self._outlet.fileno(), 4096):
                self._said += data


def _end(pipe: IO[bytes] | None) -> IO[bytes]:
    """Return our end of a pipe, set never to block."""
    if pipe is None:
        raise ValueError("the recorder process was started without a pipe")
    os.set_blocking(pipe.fileno(), False)
    return pipe


def _widen(descriptor: int) -> None:
    """Ask Linux for a pipe that holds a minute or so; elsewhere the backlog does."""
    if sys.platform == "linux":
        import fcntl

        with contextlib.suppress(OSError):
            fcntl.fcntl(descriptor, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
