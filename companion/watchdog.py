"""Tells systemd that the control loop lives: READY, WATCHDOG and STATUS over its own socket.

The loop itself calls ``alive``: when the loop hangs, nothing is told, and systemd ends the program
(WatchdogSec of the unit that ``companion service`` prints). The protocol is sd_notify(3): one
datagram of ``KEY=VALUE`` lines to the address in NOTIFY_SOCKET.
"""

import contextlib
import socket
from collections.abc import Mapping
from types import TracebackType

from companion import clock

_BEATS_PER_TIMEOUT = 4
_PERIOD_S = 1.0
"""How often systemd is told where it wants no watchdog."""


class Watchdog:
    """Says that the loop lives, if anybody wants to know; never blocks, never raises."""

    def __init__(self, environment: Mapping[str, str], *, process_id: int) -> None:
        """Read NOTIFY_SOCKET, WATCHDOG_USEC and WATCHDOG_PID; without them all calls do nothing.

        Args:
            environment: The process's, as systemd made it.
            process_id: Ours; a watchdog meant for another process is not ours to feed.
        """
        self._socket: socket.socket | None = None
        self._period_s = _PERIOD_S
        self._due_s = float("-inf")
        self._phase = ""
        address = environment.get("NOTIFY_SOCKET", "")
        if not address:
            return
        timeout_us = environment.get("WATCHDOG_USEC", "")
        if timeout_us.isdigit() and environment.get("WATCHDOG_PID") in (None, str(process_id)):
            self._period_s = min(_PERIOD_S, int(timeout_us) * 1e-6 / _BEATS_PER_TIMEOUT)
        opened = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
        opened.setblocking(False)
        try:
            opened.connect("\0" + address[1:] if address.startswith("@") else address)
        except OSError:
            opened.close()
            return
        self._socket = opened

    def __enter__(self) -> "Watchdog":
        return self

    def __exit__(
        self,
        _kind: type[BaseException] | None,
        _error: BaseException | None,
        _trace: TracebackType | None,
    ) -> None:
        self._tell("STOPPING=1\nSTATUS=done")
        if self._socket is not None:
            self._socket.close()

    def alive(self, phase: str) -> None:
        """Tell that the loop has made another turn, in this phase; the first one is READY."""
        if self._socket is None:
            return
        now_s = clock.now_s()
        if now_s < self._due_s and phase == self._phase:
            return
        ready = "" if self._phase else "READY=1\n"
        self._due_s, self._phase = now_s + self._period_s, phase
        self._tell(f"{ready}WATCHDOG=1\nSTATUS={phase}")

    def _tell(self, message: str) -> None:
        if self._socket is not None:
            with contextlib.suppress(OSError):  # full, or systemd is gone: the flight goes on
                self._socket.send(message.encode())
