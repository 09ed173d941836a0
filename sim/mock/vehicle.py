"""The mock as a whole: an autopilot, its links, the targets beside it, faults and a referee.

No socket and no clock: the shell (or a test) calls ``receive`` with bytes, ``advance`` with the
time, and sends what ``take_output`` returns.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import repeat
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim.mock.autopilot import COMPONENT_ID, CRITICAL, Autopilot, PowerUp
from sim.mock.channel import Channel, Port
from sim.mock.conduct import SETPOINTS, Conduct
from sim.mock.dynamics import ZERO, PointMass, Response, Vector, Wind
from sim.mock.faults import Fault, Schedule
from sim.mock.incoming import handle
from sim.mock.intruder import Intruder
from sim.mock.personality import Personality
from sim.mock.placement import Place
from sim.mock.px4.personality import PX4
from sim.mock.referee import PERIOD_S, Contact, Referee
from sim.mock.signing import Keyring
from sim.mock.targets import Target
from sim.mock.wire import Impairment, Wire

TICK_S = 0.01
"""Step of physics and streams; the fastest stream has 100 Hz."""
_REFEREE_TICKS = round(PERIOD_S / TICK_S)


@dataclass(frozen=True, slots=True)
class Settings:
    """What a mock vehicle can be told."""

    place: Place
    boot_s: float = 1.5
    radio: bool = False
    personality: Personality = PX4
    response: Response | None = None
    """``None`` for that of the personality's simulator."""
    wind_ned_mps: Vector = ZERO
    gust_mps: float = 0.0
    noise_m: float = 0.0
    system_id: int = 1
    signing_key: bytes | None = None
    """32 bytes that everybody on the links signs with; ``None`` where nobody does."""
    signing_stamp: int = 0
    """The stamp at power-up, see ``signing.stamp_at``."""
    usb_link: int = 0
    """Which link is the USB port, counted from 1; 0 where none is."""


class MockVehicle:
    """An autopilot with its links and its surroundings.

    Args:
        settings: The vehicle.
        ground_links: One entry per link: whether it has ground-station rates.
        rng: Source of all chance.
        targets: Other systems on the same links.
        faults: What goes wrong, and when.
    """

    def __init__(
        self,
        settings: Settings,
        *,
        ground_links: Sequence[bool],
        rng: np.random.Generator,
        targets: Sequence[Target] = (),
        faults: Sequence[Fault] = (),
    ) -> None:
        self.settings = settings
        self.targets = list(targets)
        self.referee = Referee(settings.place)
        self.conduct = Conduct()
        self.impairments = [Impairment() for _ in ground_links]
        self.intruder: Intruder | None = None
        self.time_s = 0.0
        self._personality = settings.personality
        self._keyring = Keyring(
            settings.signing_key, settings.signing_stamp, self._personality.unsigned_allowed
        )
        usb_link = settings.usb_link - 1 if self._personality.trusts_usb else None
        self._channels = [
            self._personality.open_channel(
                Port(ground, settings.system_id, self._keyring, trusted=number == usb_link)
            )
            for number, ground in enumerate(ground_links)
        ]
        self._heard: list[set[tuple[int, int]]] = [set() for _ in ground_links]
        self._inbound = [Wire(impairment, rng) for impairment in self.impairments]
        self._outbound = [Wire(impairment, rng) for impairment in self.impairments]
        self._listener: Any = mavlink.MAVLink(None)
        self._schedule = Schedule(list(faults))
        self._rng = rng
        self._ticks = 0
        self._power_up_s = 0.0
        self._log: list[str] = []
        self.autopilot = self._power_up(PointMass(settings.response or self._personality.response))

    @property
    def channels(self) -> Sequence[Channel]:
        """The links, in the order they were given."""
        return self._channels

    def stream_only(self, message_ids: Collection[int]) -> None:
        """Build these streams alone, because nobody reads the others; answers are sent as ever."""
        listened_to = frozenset({*message_ids, mavlink.MAVLINK_MSG_ID_HEARTBEAT})
        for channel in self._channels:
            channel.listen_to(listened_to)

    def receive(self, link: int, data: bytes) -> None:
        """Take in bytes that arrived on a link."""
        self._deliver(link, [data])

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
        """Return (link, bytes) for everything to be sent, in order."""
        output: list[tuple[int, bytes]] = []
        for link, (channel, wire) in enumerate(zip(self._channels, self._outbound, strict=True)):
            packets = wire.carry(self.time_s, channel.take_output())
            output += zip(repeat(link), packets)
        return output

    def log(self, line: str) -> None:
        """Note something for the person at the terminal."""
        self._log.append(f"{self.time_s:.2f} s: {line}")

    def take_log(self) -> list[str]:
        """Return the lines since the last call."""
        log, self._log = self._log, []
        return log

    def report(self) -> dict[str, Any]:
        """Return the referee's verdict."""
        report = self.referee.report(self.time_s, self.autopilot)
        contacts = len(report["contacts"])
        said = [f"{contacts} contacts with obstacles"] if contacts else []
        return {
            "passed": not said + self.conduct.lines(),
            "complaints": said + self.conduct.lines(),
            "complaints_by_sender": {
                sender: dict(kinds) for sender, kinds in self.conduct.complaints.items()
            },
            **report,
            "packets_refused": dict(self._keyring.refused),
        }

    def reboot(self) -> None:
        """Restart the autopilot: its clock begins at zero, nothing is armed."""
        self._power_up_s = self.time_s
        self.autopilot = self._power_up(self.autopilot.body)

    def _tick(self) -> None:
        if self._keyring.secret is not None:
            self._keyring.advance(TICK_S)
        self._schedule.tick(self.time_s, self)
        for link, wire in enumerate(self._inbound):
            if wire.under_way:
                self._deliver(link, [])
        if self.intruder is not None:
            self._broadcast(self.intruder.tick(self.time_s), heard_by_us=True)
        self.autopilot.step(self.time_s - self._power_up_s)
        if self._ticks % _REFEREE_TICKS == 0:
            shown = [channel.shown_mode for channel in self._channels]
            self.conduct.watch(self.time_s, self.autopilot, shown)
            contact = self.referee.observe(self.time_s, self.autopilot)
            if contact is not None:
                self._tell_contact(contact)
        for target in self.targets:
            self._broadcast(target.tick(self.time_s), heard_by_us=False)
        texts = self.autopilot.take_texts()
        for channel in self._channels:
            if texts:
                channel.tell(self.autopilot.now_s, texts)
            channel.tick(self.autopilot)

    def _power_up(self, body: PointMass) -> Autopilot:
        settings = self.settings
        for channel in self._channels:
            channel.restart(settings.boot_s)
        return self._personality.build(
            PowerUp(
                place=settings.place.home,
                boot_s=settings.boot_s,
                radio=settings.radio,
                body=body,
                wind=Wind(self._rng, settings.wind_ned_mps, settings.gust_mps),
                noise_m=settings.noise_m,
                rng=self._rng,
                system_id=settings.system_id,
            )
        )

    def _deliver(self, link: int, packets: list[bytes]) -> None:
        channel = self._channels[link]
        for packet in self._inbound[link].carry(self.time_s, packets):
            for message in channel.decode(packet):
                self._heard[link].add((message.get_srcSystem(), message.get_srcComponent()))
                self._hear(message, link, judged=True)
                self._route(link, message)

    def _hear(self, message: Any, link: int, *, judged: bool) -> None:
        others = [heard for number, heard in enumerate(self._heard) if number != link]
        elsewhere = set().union(*others) if others else ()
        if not self._personality.is_for_us(message, self.settings.system_id, elsewhere):
            return
        channel = self._channels[link]
        if message.get_type() in SETPOINTS:
            sender = f"{message.get_srcSystem()}/{message.get_srcComponent()}"
            self.referee.count_setpoint(sender, self.autopilot.mode, channel.shown_mode)
        refused = self.autopilot.setpoints_refused
        if judged:
            self.conduct.hear(self.time_s, message, self.autopilot)
        handle(self._personality.handlers, self.autopilot, channel, message)
        if judged and self.autopilot.setpoints_refused > refused:
            self.conduct.refused(message)
        for line in self.conduct.take_news():
            self.log(f"complaint: {line}")
        for each in self._channels:
            each.show_changes(self.autopilot)
        if self.autopilot.wants_reboot:
            self.reboot()

    def _route(self, link: int, message: Any) -> None:
        """Pass on what is not for this autopilot alone: other parties' heartbeats above all."""
        target = getattr(message, "target_system", 0), getattr(message, "target_component", 0)
        if target == (self.settings.system_id, COMPONENT_ID):
            return
        packet = bytes(message.get_msgbuf())
        for number, channel in enumerate(self._channels):
            if number != link:
                channel.pass_on(packet)

    def _broadcast(self, packets: Sequence[bytes], *, heard_by_us: bool) -> None:
        """Put packets of others on all links, as on a shared radio."""
        for packet in packets:
            signed = self._keyring.sign_for_sender(packet)
            for channel in self._channels:
                channel.pass_on(signed)
            if heard_by_us:
                self._hear(self._listener.decode(bytearray(packet)), 0, judged=False)

    def _tell_contact(self, contact: Contact) -> None:
        east, north, up = contact.position_enu_m
        text = f"Contact with an obstacle at E {east:.1f} N {north:.1f} U {up:.1f}"
        self.log(text)
        self.autopilot.say(CRITICAL, text)
        count = len(self.referee.contacts)
        clock_ms = round(self.autopilot.now_s * 1e3)
        for channel in self._channels:
            channel.send(mavlink.MAVLink_named_value_int_message(clock_ms, b"contacts", count))
