"""One link of an autopilot: its codec and its stream rates. No socket."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim.mock.autopilot import Autopilot, FlightMode
from sim.mock.streams import Builders

SYSTEM_ID = 1
COMPONENT_ID = 1
TEXT_CHUNK = 50


class Channel(ABC):
    """A link between the autopilot and whoever is at the other end.

    Args:
        builders: The messages that can be sent.
        default_hz: Rates after power-up, by message number; what is not in it is off.
    """

    def __init__(self, builders: Builders, default_hz: Mapping[int, float]) -> None:
        self._codec: Any = mavlink.MAVLink(None, srcSystem=SYSTEM_ID, srcComponent=COMPONENT_ID)
        self._codec.robust_parsing = True
        self.shown_mode: FlightMode | None = None
        """The mode in the newest HEARTBEAT: what the other end can know."""
        self.builders = builders
        self._default_hz = default_hz
        self._interval_s: dict[int, float] = {}
        self._due_s: dict[int, float] = {}
        self._origin_sent = self._home_sent = -1
        self._text_id = 1
        self._out: list[bytes] = []

    def decode(self, data: bytes) -> list[Any]:
        """Return the valid messages completed by ``data``; garbage is skipped."""
        messages = self._codec.parse_buffer(data) or []
        return [message for message in messages if message.get_type() != "BAD_DATA"]

    def send(self, message: Any) -> None:
        """Queue a message of the autopilot."""
        self._out.append(message.pack(self._codec))
        self._codec.seq = (self._codec.seq + 1) % 256

    def send_raw_payload(self, message: Any, payload: bytes) -> None:
        """Queue ``message`` with a payload of our own, for bit patterns no float survives."""
        self._out.append(message._pack(self._codec, message.crc_extra, payload))
        self._codec.seq = (self._codec.seq + 1) % 256

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

    def tick(self, autopilot: Autopilot) -> None:
        """Queue everything that is due."""
        now_s = autopilot.now_s
        for id_, due_s in self._due_s.items():
            if now_s < due_s - 1e-9:
                continue
            interval_s = self._interval_s[id_]
            # Absolute deadlines; what was missed is skipped, never sent in a burst.
            missed = math.floor((now_s - due_s + 1e-9) / interval_s)
            self._due_s[id_] = due_s + (missed + 1) * interval_s
            self._send_stream(id_, autopilot)
        self._send_others(autopilot)

    def restart(self, boot_s: float) -> None:
        """Begin as after power-up: default rates, origin and home not sent yet."""
        self._interval_s.clear()
        self._due_s.clear()
        for id_, rate_hz in self._default_hz.items():
            self._set_rate(id_, rate_hz, 0.0)
        self._origin_sent = self._home_sent = -1

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
        if rate_hz > 0.0:
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
