"""One link of an autopilot: its codec and its stream rates. No socket."""

import contextlib
import math
from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim.mock.autopilot import COMPONENT_ID, Autopilot, FlightMode
from sim.mock.packet import MAVLINK2, Packer, crc_extra_of
from sim.mock.signing import SIGNATURE_BYTES, SIGNED, Keyring
from sim.mock.streams import Builders

TEXT_CHUNK = 50


@dataclass(frozen=True, slots=True)
class Port:
    """What a link is opened with."""

    ground: bool = False
    """Whether it has the rates of a ground-station port."""
    system_id: int = 1
    keyring: Keyring = field(default_factory=Keyring)
    """The key of the vehicle; empty where nobody signs."""
    trusted: bool = False
    """Whether packets are taken without a good signature, as on ArduPilot's USB port."""


class Channel(ABC):
    """A link between the autopilot and whoever is at the other end.

    Args:
        builders: The messages that can be sent.
        default_hz: Rates after power-up, by message number; what is not in it is off.
        port: Whose link it is.
    """

    def __init__(self, builders: Builders, default_hz: Mapping[int, float], port: Port) -> None:
        self._packer = Packer(port.system_id, COMPONENT_ID)
        self._parser: Any = mavlink.MAVLink(None)
        self._parser.robust_parsing = True
        self.keyring = port.keyring
        self._trusted = port.trusted
        self.shown_mode: FlightMode | None = None
        """The mode in the newest HEARTBEAT: what the other end can know."""
        self.builders = builders
        self._default_hz = default_hz
        self._interval_s: dict[int, float] = {}
        self._due_s: dict[int, float] = {}
        self._origin_sent = self._home_sent = -1
        self._listened_to: Collection[int] | None = None
        self._text_id = 1
        self.ack_delay_s = 0.0
        """A fault: answers to commands come so much later."""
        self.ack_progress = False
        """A fault: meanwhile the answer is IN_PROGRESS."""
        self._acks: list[tuple[float, Any]] = []
        self._out: list[bytes] = []

    def decode(self, data: bytes) -> list[Any]:
        """Return the valid messages completed by ``data``; garbage is skipped."""
        return [
            message
            for message in self._parse(data)
            if message.get_type() != "BAD_DATA"
            and (self._trusted or self.keyring.admits(bytes(message.get_msgbuf())))
        ]

    def _parse(self, data: bytes) -> list[Any]:
        whole = (
            len(data) >= 12
            and data[0] == MAVLINK2
            and len(data) == 12 + data[1] + (SIGNATURE_BYTES if data[2] & SIGNED else 0)
            and self._parser.buf_len() == 0
        )
        if whole:  # one datagram, one packet: the long way through the parser is not needed
            with contextlib.suppress(mavlink.MAVError):
                return [self._parser.decode(bytearray(data))]
        return self._parser.parse_buffer(data) or []

    def send(self, message: Any) -> None:
        """Queue a message of the autopilot, signed where there is a key."""
        packet = self._packer.pack(message)
        if self.keyring.secret is not None:
            packet = self.keyring.sign(packet, crc_extra_of(message))
        self._out.append(packet)

    def acknowledge(self, now_s: float, asked: Any, number: int, result: int) -> None:
        """Queue COMMAND_ACK for whoever sent ``asked``."""

        def answer(result: int) -> Any:
            asker = asked.get_srcSystem(), asked.get_srcComponent()
            return mavlink.MAVLink_command_ack_message(number, result, 0, 0, *asker)

        if self.ack_delay_s > 0.0:
            if self.ack_progress:
                self.send(answer(mavlink.MAV_RESULT_IN_PROGRESS))
            self._acks.append((now_s + self.ack_delay_s, answer(result)))
        else:
            self.send(answer(result))

    def pass_on(self, packet: bytes) -> None:
        """Queue somebody else's packet unchanged."""
        self._out.append(packet)

    def take_output(self) -> list[bytes]:
        """Return the packets queued since the last call."""
        out, self._out = self._out, []
        return out

    def set_interval(self, message_id: int, interval_us: float, now_s: float) -> bool:
        """Handle SET_MESSAGE_INTERVAL: microseconds, 0 for the default, -1 for off.

        Returns:
            Whether the message is known.
        """
        if message_id not in self.builders or not math.isfinite(interval_us):
            return False
        default_hz = self._default_hz.get(message_id, 0.0)
        rate_hz = default_hz if interval_us == 0.0 else 1e6 / interval_us
        self._set_rate(message_id, rate_hz if interval_us >= 0.0 else 0.0, now_s)
        return True

    def interval_us(self, message_id: int) -> int:
        """Return what MESSAGE_INTERVAL says of a stream; 0 for one that is off."""
        return round(1e6 * self._interval_s.get(message_id, 0.0))

    def tick(self, autopilot: Autopilot) -> None:
        """Queue everything that is due."""
        now_s = autopilot.now_s
        while self._acks and self._acks[0][0] <= now_s:
            self.send(self._acks.pop(0)[1])
        for id_, due_s in self._due_s.items():
            if now_s < due_s - 1e-9:
                continue
            interval_s = self._interval_s[id_]
            late_s = now_s - due_s + 1e-9
            # Absolute deadlines; what was missed is skipped, never sent in a burst.
            missed = 0 if late_s < interval_s else math.floor(late_s / interval_s)
            self._due_s[id_] = due_s + (missed + 1) * interval_s
            if id_ == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
                self._send_stream(id_, autopilot)
                continue
            message = self.builders[id_](autopilot)
            if message is not None:
                self.send(message)
        self._send_others(autopilot)

    def restart(self, boot_s: float) -> None:
        """Begin as after power-up: default rates, origin and home not sent yet."""
        self._interval_s.clear()
        self._due_s.clear()
        self._acks.clear()
        for id_, rate_hz in self._default_hz.items():
            self._set_rate(id_, rate_hz, 0.0)
        self._origin_sent = self._home_sent = -1

    def listen_to(self, message_ids: Collection[int]) -> None:
        """Send these streams alone: nobody reads the others."""
        self._listened_to = message_ids
        for id_ in [id_ for id_ in self._due_s if id_ not in message_ids]:
            self._set_rate(id_, 0.0, 0.0)

    @abstractmethod
    def hear_gcs(self, now_s: float) -> None:
        """Note a heartbeat of type GCS on this link."""

    @abstractmethod
    def tell(self, now_s: float, texts: list[tuple[int, str]]) -> None:
        """Queue texts of the autopilot as (severity, text)."""

    @abstractmethod
    def show_changes(self, autopilot: Autopilot) -> None:
        """Queue what is shown at once when a message has been obeyed."""

    @abstractmethod
    def _send_others(self, autopilot: Autopilot) -> None:
        """Queue what is not sent at a rate."""

    def _send_stream(self, message_id: int, autopilot: Autopilot) -> bool:
        message = self.builders[message_id](autopilot)
        if message is None:
            return False
        self.send(message)
        if message_id == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
            self.shown_mode = autopilot.mode
        return True

    def _set_rate(self, message_id: int, rate_hz: float, now_s: float) -> None:
        self._interval_s.pop(message_id, None)
        self._due_s.pop(message_id, None)
        if rate_hz > 0.0 and (self._listened_to is None or message_id in self._listened_to):
            self._interval_s[message_id] = 1.0 / rate_hz
            self._due_s[message_id] = now_s

    def _statustext(self, severity: int, data: bytes) -> list[Any]:
        """Return the messages for one text, chunked at 50 characters."""
        chunks = [data[i : i + TEXT_CHUNK] for i in range(0, len(data), TEXT_CHUNK)]
        number, self._text_id = self._text_id, self._text_id % 65535 + 1
        return [
            mavlink.MAVLink_statustext_message(severity, chunk, number, sequence)
            for sequence, chunk in enumerate(chunks)
        ]
