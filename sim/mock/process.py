"""The loop of the mock process: sockets on one side, the vehicle on the other."""

import os
import select
import signal
import sys
from collections.abc import Sequence
from types import FrameType

from companion import clock
from sim.mock.sockets import Link
from sim.mock.vehicle import MockVehicle

MAX_BEHIND_S = 0.5
"""When the machine stalls for longer, the vehicle loses that time instead of bursting."""


class StopSignal:
    """SIGINT and SIGTERM, or the death of the parent, as a question."""

    def __init__(self, *, with_parent: bool) -> None:
        self._parent = os.getppid() if with_parent else None
        self._received = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._receive)

    def requested(self) -> bool:
        """Return whether it is time to end."""
        return self._received or (self._parent is not None and os.getppid() != self._parent)

    def _receive(self, number: int, frame: FrameType | None) -> None:
        self._received = True


def run(vehicle: MockVehicle, links: Sequence[Link], *, speed: float, stop: StopSignal) -> None:
    """Run the vehicle until ``stop`` says so.

    Args:
        vehicle: The vehicle; its link numbers are indices into ``links``.
        links: Open links.
        speed: Simulated seconds per second.
        stop: When to end.
    """
    start_s = clock.now_s()
    while not stop.requested():
        due_s = start_s + vehicle.next_tick_s() / speed
        waiting = {link.fileno(): number for number, link in enumerate(links) if link.fileno() >= 0}
        ready, _, _ = select.select(list(waiting), [], [], max(0.0, due_s - clock.now_s()))
        for descriptor in ready:
            number = waiting[descriptor]
            for data in links[number].receive():
                vehicle.receive(number, data)
        now_s = clock.now_s()
        start_s += max(0.0, now_s - due_s - MAX_BEHIND_S)
        vehicle.advance((now_s - start_s) * speed)
        for number, packet in vehicle.take_output():
            links[number].send(packet)
        for line in vehicle.take_log():
            print(f"mock: {line}", file=sys.stderr, flush=True)
