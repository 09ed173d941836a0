"""The log on stderr, which must never hold the loop.

A terminal stopped with Ctrl-S, or a pipe that nobody reads, blocks whoever writes to it. Lines are
written only as far as they fit at once; some are kept until there is room again, older ones are
dropped and counted. Times are of the monotonic clock: a step of the wall clock does not show.
"""

import contextlib
import logging
import os
import select
import stat
from collections import deque

from companion import clock

_LINE_BYTES = select.PIPE_BUF
"""What a pipe that select calls writable takes whole."""
_KEPT_LINES = 200
_PATIENCE_S = 0.5


class TerminalHandler(logging.Handler):
    """Writes log lines to a file descriptor without ever waiting for it."""

    def __init__(self, descriptor: int = 2) -> None:
        super().__init__()
        self._descriptor = _unblocked(descriptor)
        self._start_s = clock.now_s()
        self._lines: deque[bytes] = deque()
        self.dropped = 0
        """Lines that nobody has seen."""

    def emit(self, record: logging.LogRecord) -> None:
        """Take one log record."""
        try:
            text = self.format(record)
        except (TypeError, ValueError):  # arguments that do not fit the message
            text = str(record.msg)
        since_ms = 1e3 * (clock.now_s() - self._start_s)
        self.write(f"{since_ms:8.0f} ms  {text}")

    def write(self, text: str) -> None:
        """Write as it is, now or as soon as there is room."""
        for line in text.splitlines():
            if len(self._lines) == _KEPT_LINES:
                self._lines.popleft()
                self.dropped += 1
            self._lines.append(line.encode(errors="replace")[: _LINE_BYTES - 1] + b"\n")
        self._drain(0.0)

    def flush(self) -> None:
        """Give the reader a moment to take what is left."""
        self._drain(_PATIENCE_S)

    def _drain(self, patience_s: float) -> None:
        """Write what fits; wait for more room no longer than ``patience_s``."""
        end_s = clock.now_s() + patience_s
        while self._lines:
            left_s = max(0.0, end_s - clock.now_s()) if patience_s else 0.0
            if not select.select([], [self._descriptor], [], left_s)[1]:
                return
            if self.dropped:
                self._lines.appendleft(b"(%d lines were not shown)\n" % self.dropped)
                self.dropped = 0
            line = self._lines.popleft()
            try:
                written = os.write(self._descriptor, line)
            except BlockingIOError:
                written = 0
            except OSError:  # nobody is there any more, or the disk behind it is full
                self.dropped += 1
                return
            if written < len(line):
                self._lines.appendleft(line[written:])
                if not patience_s:
                    return


def _unblocked(descriptor: int) -> int:
    """Return a terminal opened anew so that writing to it does not block us, and only us.

    The flag belongs to the open terminal, not to the process: set on the one we were given, it
    would hold for the shell too. Of pipes and sockets, select already tells all that is needed.
    """
    if stat.S_ISCHR(os.fstat(descriptor).st_mode):
        flags = os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC
        with contextlib.suppress(OSError):
            return os.open(f"/proc/self/fd/{descriptor}", flags)
    return descriptor
