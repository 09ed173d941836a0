"""The stream of setpoints: who sends it, its rate, its gaps."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.arrays import FloatArray
from companion.review.story import Message, Story
from companion.vehicle import Severity

_GAP_S = 0.5  # half of what PX4 allows before its failsafe (COM_OF_LOSS_T)
_END_S = 2.5
_HAND_OVER_S = 1.5  # PX4 tells a mode with its next HEARTBEAT
_BODY_FRAMES = (
    dialect.MAV_FRAME_BODY_NED,
    dialect.MAV_FRAME_BODY_OFFSET_NED,
    dialect.MAV_FRAME_BODY_FRD,
)
_VELOCITY_IGNORED = 8 | 16 | 32  # POSITION_TARGET_TYPEMASK


@dataclass
class Stream:
    """The setpoints of one sender since it last began."""

    began_s: float
    last_s: float
    flying: bool
    """Whether the last of them flew the vehicle."""
    count: int = 1


@dataclass
class Setpoints:
    """Follows the setpoints of every sender."""

    story: Story
    velocity_ned_mps: FloatArray | None = None
    """The newest velocity asked for, in the local frame or the body's."""
    in_body: bool = False
    time_s: float = -math.inf
    total: int = 0
    longest_gap_s: float = 0.0
    """While setpoints flew the vehicle."""
    senders: set[tuple[int, int]] = field(default_factory=set)
    _intervals_s: list[float] = field(default_factory=list)
    _streams: dict[tuple[int, int], Stream] = field(default_factory=dict)
    _ended_s: dict[tuple[int, int], float] = field(default_factory=dict)
    _rivals: set[frozenset[tuple[int, int]]] = field(default_factory=set)

    @property
    def handlers(self) -> Mapping[int, Callable[[Message], None]]:
        """What to call with a message, by its id."""
        return {
            dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED: self._take,
            dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT: self._take,
            dialect.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET: self._take,
        }

    def finish(self, end_s: float) -> None:
        """Tell the ends that nothing follows, and the facts."""
        for who, stream in self._streams.items():
            if end_s - stream.last_s > _GAP_S:
                self._tell_end(who, stream)
        if self.total:
            names = ", ".join(self.story.who(*who) for who in sorted(self.senders))
            rate = ""
            if self._intervals_s:
                rate = f" at {1.0 / max(1e-3, float(np.median(self._intervals_s))):.1f} Hz"
            self.story.facts.append(("Setpoints", f"{self.total}{rate}, from {names}"))
            self.story.facts.append(("Longest setpoint gap", f"{self.longest_gap_s:.2f} s"))

    def tick(self, now_s: float) -> None:
        """Notice streams that have ended."""
        for who, stream in list(self._streams.items()):
            if now_s - stream.last_s > _END_S:
                self._tell_end(who, stream)
                del self._streams[who]
                if stream.flying:
                    self._ended_s[who] = stream.last_s
        state = "setpoints" if now_s - self.time_s < _GAP_S else "none"
        if self.total:
            self.story.band("setpoints", now_s, state)

    def _take(self, message: Message) -> None:
        fields, story, now_s = message.fields, self.story, message.time_s
        if fields.target_system not in (0, story.vehicle):
            return
        who = (message.system_id, message.component_id)
        self.total += 1
        self.senders.add(who)
        self.time_s = story.setpoint_s = now_s
        self._note_velocity(message)
        flying = story.external and story.armed
        stream = self._streams.get(who)
        if stream is None:
            self._streams[who] = Stream(now_s, now_s, flying)
            if who in self._ended_s:
                self._note_gap(now_s - self._ended_s.pop(who))
            story.stream_began_s = now_s
            story.tell(now_s, f"setpoints of {story.who(*who)} begin")
            self._tell_rivals(now_s)
            return
        gap_s = now_s - stream.last_s
        flew, stream.flying = stream.flying, flying
        stream.last_s = now_s
        stream.count += 1
        if gap_s <= _GAP_S:
            self._intervals_s.append(gap_s)
            return
        story.stream_began_s = now_s
        if flew:
            self._note_gap(gap_s)
        story.tell(
            now_s,
            f"no setpoint of {story.who(*who)} for {gap_s:.2f} s",
            Severity.WARNING if flew else Severity.INFO,
        )

    def _note_gap(self, gap_s: float) -> None:
        self.longest_gap_s = max(self.longest_gap_s, gap_s)

    def _tell_end(self, who: tuple[int, int], stream: Stream) -> None:
        story = self.story
        lasted_s = stream.last_s - stream.began_s
        rate = f" at {(stream.count - 1) / lasted_s:.1f} Hz" if lasted_s > 0.0 else ""
        over_s = story.handed_over_s
        handed_over = over_s is not None and 0.0 <= over_s - stream.last_s < _HAND_OVER_S
        flying = stream.flying and not handed_over
        text = f"setpoints of {story.who(*who)} end: {stream.count}{rate}"
        story.tell(
            stream.last_s,
            text + (", while they fly the vehicle" if flying else ""),
            Severity.WARNING if flying else Severity.INFO,
        )

    def _tell_rivals(self, now_s: float) -> None:
        live = frozenset(
            who for who, stream in self._streams.items() if now_s - stream.last_s < _GAP_S
        )
        if len(live) > 1 and live not in self._rivals:
            self._rivals.add(live)
            names = " and ".join(self.story.who(*who) for who in sorted(live))
            self.story.warn(now_s, f"SEVERAL send setpoints at once: {names}")

    def _note_velocity(self, message: Message) -> None:
        fields = message.fields
        if not hasattr(fields, "vx") or fields.type_mask & _VELOCITY_IGNORED:
            self.velocity_ned_mps = None
            return
        velocity = np.array((fields.vx, fields.vy, fields.vz), dtype=np.float64)
        self.velocity_ned_mps = velocity if np.isfinite(velocity).all() else None
        self.in_body = fields.coordinate_frame in _BODY_FRAMES
