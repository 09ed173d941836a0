"""A link of PX4: the rates of its port, texts only where a ground station was heard."""

import math
from collections import deque
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim.mock.autopilot import Autopilot
from sim.mock.channel import Channel, Port
from sim.mock.px4.streams import STREAMS

GCS_TIMEOUT_S = 5.0
TEXT_SPACING_S = 0.05
"""PX4 sends at most one text per 50 ms and link."""


class Px4Channel(Channel):
    """A link between PX4 and whoever is at the other end.

    Args:
        port: Whose link it is, and whether it has ground-station rates.
    """

    def __init__(self, port: Port) -> None:
        builders = {id_: stream.build for id_, stream in STREAMS.items()}
        rates = {id_: s.ground_hz if port.ground else s.onboard_hz for id_, s in STREAMS.items()}
        super().__init__(builders, rates, port)
        self._gcs_heard_s = -math.inf
        self._next_text_s = 0.0
        self._ping_due_s = 0.0
        self._texts: deque[Any] = deque()
        self._ping_seq = 0

    def hear_gcs(self, now_s: float) -> None:
        """Note a heartbeat of type GCS: from now on this link gets texts."""
        self._gcs_heard_s = now_s

    def tell(self, now_s: float, texts: list[tuple[int, str]]) -> None:
        """Queue texts if a ground station is on this link."""
        if now_s - self._gcs_heard_s > GCS_TIMEOUT_S:
            return
        for severity, text in texts:
            self._texts.extend(self._statustext(severity, (text + "\t").encode()))

    def restart(self, boot_s: float) -> None:
        """Begin as after power-up.

        One heartbeat is made to fall on the moment the vehicle becomes ready, ``boot_s``.
        """
        super().restart(boot_s)
        self._due_s[mavlink.MAVLINK_MSG_ID_HEARTBEAT] = boot_s % 1.0
        self._next_text_s = self._ping_due_s = 0.0
        self._gcs_heard_s = -math.inf

    def show_changes(self, autopilot: Autopilot) -> None:
        """Queue nothing: PX4 shows every change in the next HEARTBEAT."""

    def _send_others(self, autopilot: Autopilot) -> None:
        now_s = autopilot.now_s
        # Origin and home are sent when they change (P19).
        if autopilot.estimator.origin_count != self._origin_sent and self._send_stream(
            mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN, autopilot
        ):
            self._origin_sent = autopilot.estimator.origin_count
        if autopilot.home_count != self._home_sent and self._send_stream(
            mavlink.MAVLINK_MSG_ID_HOME_POSITION, autopilot
        ):
            self._home_sent = autopilot.home_count
        if now_s >= self._ping_due_s and autopilot.estimator.attitude_known(now_s):
            self._ping_due_s = math.floor(now_s) + 1.0
            self.send(mavlink.MAVLink_ping_message(round(now_s * 1e6), self._ping_seq, 0, 0))
            self._ping_seq += 1
        if self._texts and now_s >= self._next_text_s:
            self._next_text_s = now_s + TEXT_SPACING_S
            self.send(self._texts.popleft())
            while self._texts and self._texts[0].chunk_seq > 0:
                self.send(self._texts.popleft())
