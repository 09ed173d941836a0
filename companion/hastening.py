"""Flying a mock vehicle that lives faster than we do: our clock and our waiting as fast as its own.

Everything else asks the clock that it is given, so that a flight is the same in less time: rates,
time-outs and lags are in the vehicle's seconds. Only the computer does not become quicker: from
some speed on ticks are late.
"""

from collections.abc import Callable

from companion import clock
from companion.link.transport import Peer, Transport


def hastened_clock(speed: float) -> Callable[[], float]:
    """Return a clock that shows ``speed`` seconds in a second, beginning now."""
    if speed == 1.0:
        return clock.now_s
    start_s = clock.now_s()
    return lambda: start_s + speed * (clock.now_s() - start_s)


class HastenedTransport:
    """A transport that waits in the seconds of such a clock."""

    def __init__(self, transport: Transport, speed: float) -> None:
        self._transport, self._speed = transport, speed
        self.speaks_first = transport.speaks_first
        self.send_errors = 0

    def wait(self, timeout_s: float) -> None:
        """Block until bytes may be there, at most ``timeout_s`` of the hastened clock."""
        self._transport.wait(timeout_s / self._speed)

    def receive(self) -> list[tuple[Peer, bytes]]:
        """Return what is there, by peer."""
        received = self._transport.receive()
        self.send_errors = self._transport.send_errors
        return received

    def reply_to(self, peer: Peer) -> None:
        """Send to ``peer`` from now on."""
        self._transport.reply_to(peer)

    def send(self, data: bytes) -> None:
        """Send one packet, or count that it could not be sent."""
        self._transport.send(data)
        self.send_errors = self._transport.send_errors

    def close(self) -> None:
        """Release the socket or port."""
        self._transport.close()
