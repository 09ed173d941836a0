"""What other systems report of themselves: targets that fall silent, freeze or jump."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.review.story import Message, Story
from companion.vehicle import Severity

_OLD_S = 2.0
_FASTEST_MPS = 60.0
_JUMP_M = 15.0
_TWO_PLACES = 3  # jumps without a steady report between them
_METRES_PER_DEGREE = 111_320.0


@dataclass
class _Report:
    heard_s: float
    """When it was last heard."""
    new_s: float
    """When it last said something new."""
    content: tuple[int, ...]
    told: bool = False
    jumps: int = 0
    """To and fro, one after the other."""


class Others:
    """Follows the positions of systems that are not the vehicle."""

    def __init__(self, story: Story) -> None:
        self._story = story
        self._reports: dict[int, _Report] = {}
        self.handlers: Mapping[int, Callable[[Message], None]] = {
            dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: self._take,
            dialect.MAVLINK_MSG_ID_FOLLOW_TARGET: self._take,
        }

    def tick(self, now_s: float) -> None:
        """Notice who says nothing, or nothing new."""
        for system_id, report in self._reports.items():
            if report.told or now_s - report.new_s < _OLD_S:
                continue
            report.told = True
            silent = now_s - report.heard_s > 0.5 * _OLD_S
            what = "is SILENT" if silent else "repeats ONE report, as if frozen,"
            self._story.warn(now_s, f"system {system_id} {what} since {report.new_s:.1f} s")

    def finish(self, end_s: float) -> None:
        """Say nothing more: a log may end whenever it likes."""

    def _take(self, message: Message) -> None:
        if message.system_id == self._story.vehicle:
            return
        fields, now_s = message.fields, message.time_s
        content = (fields.lat, fields.lon, round(1e3 * fields.alt))
        velocity = getattr(fields, "vel", None) or (fields.vx, fields.vy, fields.vz)
        still = not any(velocity)
        report = self._reports.get(message.system_id)
        if report is None:
            self._reports[message.system_id] = _Report(now_s, now_s, content)
            return
        report.heard_s = now_s
        if content == report.content and not still:
            return
        self._check_jump(message.system_id, report, content, now_s)
        if report.told:
            text = f"system {message.system_id} reports something new again"
            self._story.tell(now_s, text, Severity.NOTICE)
        report.new_s, report.content, report.told = now_s, content, False

    def _check_jump(
        self, system_id: int, report: _Report, content: tuple[int, ...], now_s: float
    ) -> None:
        north_m = (content[0] - report.content[0]) * 1e-7 * _METRES_PER_DEGREE
        shrink = math.cos(math.radians(content[0] * 1e-7))
        east_m = (content[1] - report.content[1]) * 1e-7 * _METRES_PER_DEGREE * shrink
        moved_m = math.hypot(north_m, east_m)
        if moved_m <= _JUMP_M + _FASTEST_MPS * (now_s - report.new_s):
            report.jumps = 0 if report.jumps < _TWO_PLACES else report.jumps
            return
        report.jumps += 1
        if report.jumps < _TWO_PLACES:
            self._story.warn(now_s, f"system {system_id} JUMPED by {moved_m:.0f} m")
        elif report.jumps == _TWO_PLACES:
            self._story.warn(
                now_s,
                f"system {system_id} reports from TWO PLACES, {moved_m:.0f} m apart, in turn: "
                "do two systems share that id?",
            )
