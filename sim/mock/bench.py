"""A mock vehicle and its clients in one process, on a virtual clock.

For tests and experiments: minutes of flight in a fraction of a second, over real MAVLink bytes
but without sockets::

    bench = Bench()
    bench.run(2.0)                                   # boot
    assert bench.command(400, 1.0) == 0              # arm: MAV_RESULT_ACCEPTED
    bench.run(5.0, stream=bench.velocity(0.0, 0.0, -1.0))
    print(bench.last("LOCAL_POSITION_NED").z)
"""

import math
from collections.abc import Callable, Collection, Sequence
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim.mock.autopilot import COMPONENT_ID
from sim.mock.faults import parse_fault
from sim.mock.packet import Packer, layout, message_name
from sim.mock.placement import place_vehicle
from sim.mock.setpoints import MAV_FRAME_LOCAL_NED
from sim.mock.targets import parse_target
from sim.mock.vehicle import TICK_S, MockVehicle, Settings

POSITION_ONLY = 0xDF8
VELOCITY_ONLY = 0xDC7
ACK_TIMEOUT_S = 0.5


class Received:
    """A packet as a client got it; decoded when somebody looks at it."""

    __slots__ = ("_message", "link", "packet", "time_s")

    def __init__(self, time_s: float, link: int, packet: bytes) -> None:
        """Note that ``packet`` arrived on ``link``."""
        self.time_s = time_s
        self.link = link
        self.packet = packet
        self._message: Any = None

    @property
    def message(self) -> Any:
        """Return the decoded message."""
        if self._message is None:
            self._message = mavlink.MAVLink(None).decode(bytearray(self.packet))
        return self._message

    @property
    def name(self) -> str:
        """Return the name of the message, without decoding it."""
        return message_name(self.packet)


class Bench:
    """A vehicle with clients on its links.

    Args:
        settings: The vehicle; by default one at PX4 SITL's home that is ready after 1.5 s.
        ground_links: One entry per link: whether it has ground-station rates.
        targets: As for ``--target``.
        faults: As for ``--fault``.
        seed: Of everything random.
        identity: System and component id that the client sends from.
        hears: Names of the streams that the client reads besides HEARTBEAT, ``None`` for all;
            the others are not built, which makes a flight twice as fast.
    """

    def __init__(
        self,
        settings: Settings | None = None,
        *,
        ground_links: Sequence[bool] = (False,),
        targets: Sequence[str] = (),
        faults: Sequence[str] = (),
        seed: int = 0,
        identity: tuple[int, int] = (1, 191),
        hears: Collection[str] | None = None,
    ) -> None:
        settings = settings or Settings(place_vehicle(None, None))
        rng = np.random.default_rng(seed)
        others = [parse_target(text, settings.place, rng) for text in targets]
        sysids = [other.sysid for other in others]
        links = len(ground_links)
        self.vehicle = MockVehicle(
            settings,
            ground_links=ground_links,
            rng=rng,
            targets=others,
            faults=[
                parse_fault(text, links=links, targets=sysids, personality=settings.personality)
                for text in faults
            ],
        )
        if hears is not None:
            self.vehicle.stream_only([_id_of(name) for name in hears])
        self._received: list[Received] = []
        self._arrived: list[tuple[float, list[tuple[int, bytes]]]] = []
        self.identity = identity
        self._packers: dict[tuple[int, int], Packer] = {}

    @property
    def time_s(self) -> float:
        """The virtual time since power-up."""
        return self.vehicle.time_s

    @property
    def received(self) -> list[Received]:
        """All packets that have come, oldest first."""
        if self._arrived:
            self._received += [
                Received(time_s, link, packet)
                for time_s, packets in self._arrived
                for link, packet in packets
            ]
            self._arrived.clear()
        return self._received

    def send(self, message: Any, *, link: int = 0, identity: tuple[int, int] | None = None) -> None:
        """Send one message from the client, or from somebody else."""
        sender = identity or self.identity
        packer = self._packers.get(sender)
        if packer is None:
            packer = self._packers[sender] = Packer(*sender)
        self.vehicle.receive(link, packer.pack(message))
        self._collect()

    def run(
        self,
        duration_s: float,
        *,
        stream: Callable[[], Any] | None = None,
        rate_hz: float = 20.0,
        until: Callable[[], bool] | None = None,
    ) -> bool:
        """Let time pass.

        Args:
            duration_s: How much.
            stream: Builds a message to be sent at ``rate_hz`` meanwhile.
            rate_hz: Rate of the stream.
            until: Ends the run early when true.

        Returns:
            Whether ``until`` became true.
        """
        start = self.vehicle.time_s
        sent = 0
        for tick in range(1, round(duration_s / TICK_S) + 1):
            if stream is not None and (tick - 1) * TICK_S * rate_hz >= sent - 1e-9:
                sent += 1
                self.send(stream())
            self.vehicle.advance(start + tick * TICK_S)
            self._collect()
            if until is not None and until():
                return True
        return False

    def command(self, number: int, *params: float, **kwargs: Any) -> int | None:
        """Send COMMAND_LONG and return the result of its ACK; ``None`` if none comes."""
        padded = (*params, *(0.0,) * (7 - len(params)))
        system = kwargs.pop("system", self.vehicle.settings.system_id)
        component = kwargs.pop("component", COMPONENT_ID)
        message = mavlink.MAVLink_command_long_message(system, component, number, 0, *padded)
        return self.ask(message, number, **kwargs)

    def ask(self, message: Any, number: int, **kwargs: Any) -> int | None:
        """Send any message and return the result of the COMMAND_ACK for ``number``."""
        before = len(self.received)
        self.send(message, **kwargs)

        def answers() -> list[Any]:
            acks = [r for r in self.received[before:] if r.name == "COMMAND_ACK"]
            return [r.message for r in acks if r.message.command == number]

        self.run(ACK_TIMEOUT_S, until=lambda: bool(answers()))
        found = answers()
        return int(found[0].result) if found else None

    def all(self, name: str, *, link: int | None = None, since_s: float = -math.inf) -> list[Any]:
        """Return the messages of one type, oldest first."""
        return [
            r.message
            for r in self.received
            if r.name == name and link in (None, r.link) and r.time_s >= since_s
        ]

    def last(self, name: str, *, link: int | None = None) -> Any:
        """Return the newest message of one type.

        Raises:
            LookupError: If there was none.
        """
        for received in reversed(self.received):
            if received.name == name and link in (None, received.link):
                return received.message
        raise LookupError(f"no {name} was received")

    def texts(self, *, link: int = 0) -> list[str]:
        """Return the texts on a link, their chunks joined."""
        texts: list[str] = []
        for message in self.all("STATUSTEXT", link=link):
            if message.chunk_seq > 0:
                texts[-1] += message.text
            else:
                texts.append(message.text)
        return [text.rstrip("\t") for text in texts]

    def velocity(self, north: float, east: float, down: float) -> Callable[[], Any]:
        """Return a stream of velocity setpoints (LOCAL_NED, mask 0xDC7)."""
        return self.setpoint(velocity=(north, east, down), type_mask=VELOCITY_ONLY)

    def position(self, north: float, east: float, down: float) -> Callable[[], Any]:
        """Return a stream of position setpoints (LOCAL_NED, mask 0xDF8)."""
        return self.setpoint(position=(north, east, down), type_mask=POSITION_ONLY)

    def setpoint(
        self,
        *,
        type_mask: int,
        position: tuple[float, float, float] = (0.0, 0.0, 0.0),
        velocity: tuple[float, float, float] = (0.0, 0.0, 0.0),
        frame: int = MAV_FRAME_LOCAL_NED,
        yaw: float = 0.0,
        target: tuple[int, int] | None = None,
    ) -> Callable[[], Any]:
        """Return a stream of any SET_POSITION_TARGET_LOCAL_NED."""
        whom = target or (self.vehicle.settings.system_id, COMPONENT_ID)
        build = layout(mavlink.MAVLink_set_position_target_local_ned_message)
        return lambda: build(
            0, *whom, frame, type_mask, *position, *velocity, 0.0, 0.0, 0.0, yaw, 0.0
        )

    def _collect(self) -> None:
        self._arrived.append((self.vehicle.time_s, self.vehicle.take_output()))


def _id_of(name: str) -> int:
    number: int = getattr(mavlink, f"MAVLINK_MSG_ID_{name}")
    return number
