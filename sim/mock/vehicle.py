"""The mock as a whole: an autopilot, its links, the targets beside it, faults and a referee.

No socket and no clock: the shell (or a test) calls ``receive`` with bytes, ``advance`` with the
time, and sends what ``take_output`` returns.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.world.frames import GeoPoint
from sim.mock import incoming
from sim.mock.channel import SYSTEM_ID, Channel
from sim.mock.dynamics import ZERO, PointMass, Response, Vector, Wind
from sim.mock.px4 import Px4

TICK_S = 0.01
"""Step of physics and streams; the fastest stream has 100 Hz."""


@dataclass(frozen=True, slots=True)
class Settings:
    """What a mock vehicle can be told."""

    home: GeoPoint
    boot_s: float = 1.5
    radio: bool = False
    response: Response = Response()
    wind_ned_mps: Vector = ZERO
    gust_mps: float = 0.0
    noise_m: float = 0.0


class MockVehicle:
    """A PX4 with its links.

    Args:
        settings: The vehicle.
        ground_links: One entry per link: whether it has ground-station rates.
        rng: Source of all chance.
    """

    def __init__(
        self, settings: Settings, *, ground_links: Sequence[bool], rng: np.random.Generator
    ) -> None:
        self.settings = settings
        self.channels = [Channel(ground=ground) for ground in ground_links]
        self.time_s = 0.0
        self._rng = rng
        self._ticks = 0
        self._power_up_s = 0.0
        self.px4 = self._power_up(PointMass(settings.response))

    def receive(self, link: int, data: bytes) -> None:
        """Take in bytes that arrived on a link."""
        channel = self.channels[link]
        for message in channel.decode(data):
            if incoming.is_for_us(message):
                incoming.handle(self.px4, channel, message)
            self._route(link, message)

    def advance(self, time_s: float) -> None:
        """Run until ``time_s``, tick by tick."""
        while (self._ticks + 1) * TICK_S <= time_s + 1e-9:
            self._ticks += 1
            self.time_s = self._ticks * TICK_S
            self._tick()

    def next_tick_s(self) -> float:
        """Return when ``advance`` has something to do again."""
        return (self._ticks + 1) * TICK_S

    def take_output(self) -> list[tuple[int, bytes]]:
        """Return (link, packet) for everything to be sent, in order."""
        return [
            (link, packet)
            for link, channel in enumerate(self.channels)
            for packet in channel.take_output()
        ]

    def _tick(self) -> None:
        self.px4.step(self.time_s - self._power_up_s)
        texts = self.px4.take_texts()
        for channel in self.channels:
            channel.tell(self.px4.now_s, texts)
            channel.tick(self.px4)

    def _power_up(self, body: PointMass) -> Px4:
        settings = self.settings
        for channel in self.channels:
            channel.restart(settings.boot_s)
        return Px4(
            place=settings.home,
            boot_s=settings.boot_s,
            radio=settings.radio,
            body=body,
            wind=Wind(self._rng, settings.wind_ned_mps, settings.gust_mps),
            noise_m=settings.noise_m,
            rng=self._rng,
        )

    def _route(self, link: int, message: object) -> None:
        """Pass on what is not for this autopilot alone: other parties' heartbeats above all."""
        target = getattr(message, "target_system", 0)
        if target == SYSTEM_ID and getattr(message, "target_component", 0) in (0, 1):
            return
        packet = bytes(message.get_msgbuf())  # type: ignore[attr-defined]
        for number, channel in enumerate(self.channels):
            if number != link:
                channel.pass_on(packet)
