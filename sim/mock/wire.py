"""A link that may lose, delay, double, spoil or reorder packets."""

import heapq
from dataclasses import dataclass, field

import numpy as np

from sim.mock.packet import message_id

COMMAND_ACK_ID = 77


@dataclass(slots=True)
class Impairment:
    """What is wrong with a link, in both directions."""

    cut: float = 0.0
    """Anything but 0: nothing passes."""
    loss: float = 0.0
    """Share of packets lost, 0 to 1."""
    duplicate: float = 0.0
    corrupt: float = 0.0
    delay_s: float = 0.0
    jitter_s: float = 0.0
    """Uniform extra delay; packets overtake each other."""
    acks_to_lose: int = 0

    @property
    def clean(self) -> bool:
        """Whether packets pass untouched."""
        return not (
            self.cut
            or self.loss
            or self.duplicate
            or self.corrupt
            or self.delay_s
            or self.jitter_s
            or self.acks_to_lose
        )


def _is_ack(packet: bytes) -> bool:
    return len(packet) > 9 and message_id(packet) == COMMAND_ACK_ID


@dataclass(slots=True)
class Wire:
    """One direction of one link."""

    impairment: Impairment
    rng: np.random.Generator
    under_way: list[tuple[float, int, bytes]] = field(default_factory=list)
    """What arrives later: (time, number, packet)."""
    _count: int = 0

    def carry(self, now_s: float, packets: list[bytes]) -> list[bytes]:
        """Hand over packets and return what arrives now, of these and of earlier ones."""
        if not self.under_way and self.impairment.clean:
            return packets
        for packet in packets:
            self._put(now_s, packet)
        arrived = []
        while self.under_way and self.under_way[0][0] <= now_s + 1e-9:
            arrived.append(heapq.heappop(self.under_way)[2])
        return arrived

    def _put(self, now_s: float, packet: bytes) -> None:
        state = self.impairment
        if state.acks_to_lose > 0 and _is_ack(packet):
            state.acks_to_lose -= 1
            return
        lost, doubled, spoilt, extra = (float(value) for value in self.rng.random(4))
        if state.cut > 0.0 or lost < state.loss:
            return
        if spoilt < state.corrupt:
            place = int(self.rng.integers(1, len(packet)))
            packet = packet[:place] + bytes([packet[place] ^ 0x55]) + packet[place + 1 :]
        arrival_s = now_s + state.delay_s + extra * state.jitter_s
        for _ in range(2 if doubled < state.duplicate else 1):
            self._schedule(arrival_s, packet)

    def _schedule(self, arrival_s: float, packet: bytes) -> None:
        self._count += 1
        heapq.heappush(self.under_way, (arrival_s, self._count, packet))
