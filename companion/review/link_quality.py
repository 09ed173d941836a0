"""The link: silences, lost packets, rates, and what the texts of everybody say."""

import math
from collections import Counter
from collections.abc import Mapping

from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.link.statustext import TextAssembler
from companion.review.log_file import Frame
from companion.review.story import Message, Story
from companion.session.curves import CHARTED
from companion.session.records import Event, Source
from companion.vehicle import Severity

_SILENCE_S = 1.5
_MANY_PERCENT = 2.0
_MANY_TWICE_PERCENT = 0.5
_FAR_BEHIND = 128  # sequence numbers, of 256: the sender has begun anew
_PLAIN = {message_id: message.msgname for message_id, message in dialect.mavlink_map.items()}


class LinkQuality:
    """Counts every frame of the log."""

    def __init__(self, story: Story) -> None:
        self._story = story
        self._last_sequence: dict[tuple[int, int], int] = {}
        self._heard: Counter[tuple[int, int]] = Counter()
        self._lost: Counter[tuple[int, int]] = Counter()
        self._twice: Counter[tuple[int, int]] = Counter()
        self._last_s: float | None = None
        self._second = -1
        self._in_second: Counter[str] = Counter()
        self._names: Mapping[int, str] = _PLAIN
        self.rates_hz: list[tuple[float, dict[str, float]]] = []
        """By second: the rate of each message that is charted."""

    def take(self, frame: Frame) -> None:
        """Count one frame."""
        story = self._story
        sender = (frame.system_id, frame.component_id)
        last = self._last_sequence.get(sender)
        gap = 0 if last is None else (frame.sequence - last - 1) % 256
        if last == frame.sequence:
            self._twice[sender] += 1
        elif gap < _FAR_BEHIND:
            self._last_sequence[sender] = frame.sequence
            self._lost[sender] += gap
        self._heard[sender] += 1
        if int(frame.time_s) != self._second:
            self._next_second(int(frame.time_s))
        name = self._names.get(frame.message_id, "")
        if name in CHARTED:
            self._in_second[name] += 1
        self._in_second["all messages"] += 1
        if story.is_autopilot(frame):
            if self._last_s is not None and frame.time_s - self._last_s > _SILENCE_S:
                silent_s = frame.time_s - self._last_s
                story.band("link", self._last_s, "silent")
                text = f"NOTHING was heard of the vehicle for {silent_s:.1f} s"
                story.warn(frame.time_s, text)
            story.band("link", frame.time_s, "heard")
            self._last_s = frame.time_s

    def finish(self, end_s: float) -> None:
        """Add the facts."""
        story = self._story
        self._next_second(math.ceil(end_s))
        if self._last_s is not None and end_s - self._last_s > _SILENCE_S:
            story.warn(end_s, f"the vehicle is silent since {self._last_s:.1f} s")
        for sender, heard in sorted(self._heard.items()):
            lost = self._lost[sender]
            percent = 100.0 * lost / (heard + lost)
            if sender == (story.vehicle, story.component):
                story.facts.append(("Packets lost", f"{percent:.2f} % of {heard + lost}"))
                twice = 100.0 * self._twice[sender] / heard
                if percent > _MANY_PERCENT:
                    text = f"{percent:.1f} % of the vehicle's packets were LOST over the whole log"
                    story.warn(end_s, text)
                if twice > _MANY_TWICE_PERCENT:
                    text = f"{twice:.1f} % of the vehicle's packets came TWICE over the whole log"
                    story.warn(end_s, text)

    def _next_second(self, second: int) -> None:
        if self._second >= 0 and self._in_second:
            rates = {name: float(count) for name, count in self._in_second.items()}
            self.rates_hz.append((float(self._second), rates))
        self._second = second
        self._in_second.clear()


class Texts:
    """Joins and repeats the STATUSTEXTs of everybody."""

    def __init__(self, story: Story) -> None:
        self._story = story
        self._assemblers: dict[tuple[int, int], TextAssembler] = {}
        self.handlers = {dialect.MAVLINK_MSG_ID_STATUSTEXT: self._text}

    def tick(self, now_s: float) -> None:
        """Say what will not be completed any more."""
        for who, assembler in self._assemblers.items():
            self._say(who, assembler.overdue(now_s), now_s)

    def finish(self, end_s: float) -> None:
        """Say the rest."""
        self.tick(math.inf)

    def _text(self, message: Message) -> None:
        who = (message.system_id, message.component_id)
        assembler = self._assemblers.setdefault(who, TextAssembler())
        self._say(who, assembler.add(message.fields, message.time_s), message.time_s)

    def _say(self, who: tuple[int, int], texts: list[tuple[int, str]], now_s: float) -> None:
        story = self._story
        for level, text in texts:
            severity = Severity(level) if 0 <= level <= 7 else Severity.DEBUG
            time_s = now_s if math.isfinite(now_s) else 0.0
            if who == (story.vehicle, story.component):
                story.events.append(Event(time_s, severity, "autopilot", text))
                words = text.lower()
                if "failsafe" in words and "clear" not in words:
                    story.failsafe_s = time_s
            else:
                name = story.who(*who)
                line = text if who[0] == story.vehicle else f"{name}: {text}"
                ours: Source = "companion" if who[0] == story.vehicle else "review"
                story.events.append(Event(time_s, severity, ours, line))
