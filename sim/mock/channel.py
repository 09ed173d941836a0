"""One link of the PX4 personality: its codec, its stream rates, its texts. No socket."""

import math
from collections import deque
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim.mock.modes import Mode
from sim.mock.px4 import Px4
from sim.mock.streams import STREAMS

GCS_TIMEOUT_S = 5.0
TEXT_SPACING_S = 0.05
"""PX4 sends at most one text per 50 ms and link."""
TEXT_CHUNK = 50
SYSTEM_ID = 1
COMPONENT_ID = 1


class Channel:
    """A link between the autopilot and whoever is at the other end.

    Args:
        ground: Whether it has the rates of the ground-station port instead of the onboard one.
    """

    def __init__(self, *, ground: bool) -> None:
        self._codec: Any = mavlink.MAVLink(None, srcSystem=SYSTEM_ID, srcComponent=COMPONENT_ID)
        self._codec.robust_parsing = True
        self.shown_mode: Mode | None = None
        """The mode in the newest HEARTBEAT: what the other end can know."""
        self._default_hz = {
            id_: stream.ground_hz if ground else stream.onboard_hz
            for id_, stream in STREAMS.items()
        }
        self._interval_s: dict[int, float] = {}
        self._due_s: dict[int, float] = {}
        self._gcs_heard_s = -math.inf
        self._next_text_s = 0.0
        self._ping_due_s = 0.0
        self._origin_sent = self._home_sent = -1
        self._texts: deque[Any] = deque()
        self._text_id = 1
        self._ping_seq = 0
        self._out: list[bytes] = []
        self.restart(0.0)

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
        if message_id not in STREAMS or not math.isfinite(interval_us):
            return False
        rate_hz = self._default_hz[message_id] if interval_us == 0.0 else 1e6 / interval_us
        self._set_rate(message_id, rate_hz if interval_us >= 0.0 else 0.0, now_s)
        return True

    def hear_gcs(self, now_s: float) -> None:
        """Note a heartbeat of type GCS: from now on this link gets texts."""
        self._gcs_heard_s = now_s

    def tell(self, now_s: float, texts: list[tuple[int, str]]) -> None:
        """Queue texts, chunked at 50 characters, if a ground station is on this link."""
        if now_s - self._gcs_heard_s > GCS_TIMEOUT_S:
            return
        for severity, text in texts:
            data = (text + "\t").encode()
            chunks = [data[i : i + TEXT_CHUNK] for i in range(0, len(data), TEXT_CHUNK)]
            for number, chunk in enumerate(chunks):
                self._texts.append(
                    mavlink.MAVLink_statustext_message(severity, chunk, self._text_id, number)
                )
            self._text_id = self._text_id % 65535 + 1

    def tick(self, px4: Px4) -> None:
        """Queue everything that is due."""
        now_s = px4.now_s
        for id_, due_s in self._due_s.items():
            if now_s < due_s - 1e-9:
                continue
            interval_s = self._interval_s[id_]
            # Absolute deadlines; what was missed is skipped, never sent in a burst.
            missed = math.floor((now_s - due_s + 1e-9) / interval_s)
            self._due_s[id_] = due_s + (missed + 1) * interval_s
            message = STREAMS[id_].build(px4)
            if message is None:
                continue
            self.send(message)
            if id_ == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
                self.shown_mode = px4.mode
        self._send_changes(px4)
        if now_s >= self._ping_due_s and px4.estimator.attitude_known(now_s):
            self._ping_due_s = math.floor(now_s) + 1.0
            self.send(mavlink.MAVLink_ping_message(round(now_s * 1e6), self._ping_seq, 0, 0))
            self._ping_seq += 1
        if self._texts and now_s >= self._next_text_s:
            self._next_text_s = now_s + TEXT_SPACING_S
            self.send(self._texts.popleft())
            while self._texts and self._texts[0].chunk_seq > 0:
                self.send(self._texts.popleft())

    def restart(self, boot_s: float) -> None:
        """Begin as after power-up: default rates, origin and home not sent yet.

        One heartbeat is made to fall on the moment the vehicle becomes ready, ``boot_s``.
        """
        for id_, rate_hz in self._default_hz.items():
            self._set_rate(id_, rate_hz, 0.0)
        self._due_s[mavlink.MAVLINK_MSG_ID_HEARTBEAT] = boot_s % 1.0
        self._origin_sent = self._home_sent = -1
        self._next_text_s = self._ping_due_s = 0.0
        self._gcs_heard_s = -math.inf

    def _set_rate(self, message_id: int, rate_hz: float, now_s: float) -> None:
        self._interval_s.pop(message_id, None)
        self._due_s.pop(message_id, None)
        if rate_hz > 0.0:
            self._interval_s[message_id] = 1.0 / rate_hz
            self._due_s[message_id] = now_s

    def _send_changes(self, px4: Px4) -> None:
        """Send origin and home when they change (P19)."""
        if px4.estimator.origin_count != self._origin_sent:
            message = STREAMS[mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN].build(px4)
            if message is not None:
                self._origin_sent = px4.estimator.origin_count
                self.send(message)
        if px4.home_count != self._home_sent and px4.home_true_m is not None:
            self._home_sent = px4.home_count
            self.send(STREAMS[mavlink.MAVLINK_MSG_ID_HOME_POSITION].build(px4))
