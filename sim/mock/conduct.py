"""The other half of the referee: how the companions behave, whatever the vehicle does.

Whoever sends setpoints is watched. A complaint is something that on a real vehicle would be
dangerous or would defeat a failsafe; each is counted by sender and kind, and told once when it
begins. What only a person could have meant, like asking for OFFBOARD again minutes after a
take-over, is no complaint.
"""

import math
from collections import Counter, defaultdict, deque
from collections.abc import Collection
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim.mock.autopilot import Autopilot, FlightMode
from sim.mock.commands import FORCE, CommandId

SETPOINTS = frozenset({"SET_POSITION_TARGET_LOCAL_NED", "SET_POSITION_TARGET_GLOBAL_INT"})
COMMANDS = frozenset({"COMMAND_LONG", "COMMAND_INT"})

NOTICE_S = 1.0
"""How long a companion may take to act on what a HEARTBEAT has shown."""
PAUSE_S = 1.0
"""A stream that was silent for longer has stopped and begins anew."""
ORDERED_S = 3.0
"""A mode that ends so soon after a companion's own request has ended by that."""
RETAKE_S = 10.0
"""Nobody at a ground station takes back control so soon after a take-over."""
FLOOD_HZ = 200
"""More setpoints in a second than any autopilot can use."""
STALE_S = 60.0
"""A velocity that moves the vehicle for so long without a bit of change is re-sent, not decided."""
STALE_MPS = 0.5
SENT_AGAIN = 10
"""So many times the same command within ``SENT_AGAIN_S`` is no retry any more."""
SENT_AGAIN_S = 30.0
COMMANDS_KEPT = 64
INSANE = 1000.0
"""A velocity or acceleration beyond this is a mistake of units, or no number."""

COMPLAINTS = {
    "ignores_mode": "keeps sending setpoints although a HEARTBEAT has shown that its mode is over",
    "resumes_in_failsafe": "resumes its stream during a failsafe: PX4 gives it control again",
    "retakes_control": "asks for control again right after somebody has taken it",
    "bad_numbers": "sends setpoints with NaN, infinite or absurd values",
    "refused_setpoints": "sends setpoints that the autopilot refuses or stops at",
    "free_axes": "leaves an axis of its setpoints free: PX4 stays where it is, ArduPilot stops",
    "floods": f"sends more than {FLOOD_HZ} setpoints a second",
    "stale_setpoints": f"re-sends one unchanged velocity for more than {STALE_S:.0f} s",
    "stops_motors": "stops the motors in the air by force",
    "repeats_commands": f"sends one command more than {SENT_AGAIN} times in {SENT_AGAIN_S:.0f} s",
    "heartbeat_as_gcs": "flies by setpoints and calls itself a ground station in its HEARTBEAT",
}
"""Kinds of complaints and what they mean."""


@dataclass(slots=True)
class _Sender:
    """What is remembered of one system and component."""

    last_s: float = -math.inf
    times_s: deque[float] = field(default_factory=deque)
    content: tuple[Any, ...] = ()
    content_since_s: float = 0.0
    ordered_s: float = -math.inf
    """When it has itself asked for the end of its control."""
    lost_control_s: float | None = None
    has_stopped: bool = False
    """Whether it has paused since it lost control."""
    is_gcs: bool = False
    commands: dict[str, deque[float]] = field(default_factory=lambda: defaultdict(deque))


class Conduct:
    """Watches the messages of everybody who sends setpoints."""

    def __init__(self) -> None:
        """Start with nothing seen."""
        self.complaints: dict[str, Counter[str]] = defaultdict(Counter)
        """How often, by sender and kind."""
        self._senders: dict[str, _Sender] = defaultdict(_Sender)
        self._news: list[str] = []
        self._external = self._flown = False
        self._ended_s = math.inf

    def take_news(self) -> list[str]:
        """Return complaints that have begun since the last call, in words."""
        news, self._news = self._news, []
        return news

    def lines(self) -> list[str]:
        """Return all complaints in words."""
        return [
            f"{sender} {COMPLAINTS[kind]} ({count} times)"
            for sender, kinds in self.complaints.items()
            for kind, count in kinds.items()
        ]

    def watch(
        self, now_s: float, autopilot: Autopilot, shown: Collection[FlightMode | None]
    ) -> None:
        """Note when external control has visibly ended.

        Args:
            now_s: Time.
            autopilot: The vehicle.
            shown: The modes in the newest HEARTBEAT of each link.
        """
        external = autopilot.mode.is_external
        self._flown |= external and autopilot.armed
        if external:
            self._ended_s = math.inf
        elif self._flown and autopilot.mode in shown and math.isinf(self._ended_s):
            self._ended_s = now_s
            for sender in self._senders.values():
                ordered = now_s - sender.ordered_s < ORDERED_S
                sender.lost_control_s = None if ordered else now_s
                sender.has_stopped = False

    def hear(self, now_s: float, message: Any, autopilot: Autopilot) -> None:
        """Judge one message for the autopilot, before it is obeyed."""
        kind = message.get_type()
        who = f"{message.get_srcSystem()}/{message.get_srcComponent()}"
        if kind in SETPOINTS:
            self._setpoint(now_s, who, message, autopilot)
        elif kind in COMMANDS:
            self._command(now_s, who, message, autopilot)
        elif kind == "SET_MODE":
            content = repr((CommandId.DO_SET_MODE, message.base_mode, message.custom_mode))
            self._look_for_repeats(now_s, who, content)
            number = message.custom_mode >> 16 & 0xFF or message.custom_mode
            self._look_at_mode(now_s, who, number, autopilot)
        elif kind == "HEARTBEAT":
            sender = self._senders[who]
            sender.is_gcs = message.type == mavlink.MAV_TYPE_GCS
            if sender.is_gcs and sender.last_s > -math.inf:
                self._complain(who, "heartbeat_as_gcs")

    def refused(self, message: Any) -> None:
        """Note that the autopilot has refused a setpoint."""
        self._complain(
            f"{message.get_srcSystem()}/{message.get_srcComponent()}", "refused_setpoints"
        )

    def _setpoint(self, now_s: float, who: str, message: Any, autopilot: Autopilot) -> None:
        sender = self._senders[who]
        if sender.is_gcs and math.isinf(sender.last_s):
            self._complain(who, "heartbeat_as_gcs")
        if not _sane(message):
            self._complain(who, "bad_numbers")
        if _leaves_axis_free(message.type_mask):
            self._complain(who, "free_axes")
        resumes = now_s - sender.last_s > PAUSE_S
        sender.last_s = now_s
        sender.times_s.append(now_s)
        while now_s - sender.times_s[0] > 1.0:
            sender.times_s.popleft()
        if len(sender.times_s) > FLOOD_HZ:
            self._complain(who, "floods")
        self._look_for_staleness(now_s, who, sender, message)
        if sender.lost_control_s is None or now_s - self._ended_s <= NOTICE_S:
            return
        if autopilot.failsafe_words is not None and resumes:
            self._complain(who, "resumes_in_failsafe")
        sender.has_stopped |= resumes  # what comes after a pause is a new beginning
        if not sender.has_stopped:
            self._complain(who, "ignores_mode")

    def _look_for_staleness(self, now_s: float, who: str, sender: _Sender, message: Any) -> None:
        content = message.type_mask, message.vx, message.vy, message.vz
        if content != sender.content or not _moves(message):
            sender.content, sender.content_since_s = content, now_s
        elif now_s - sender.content_since_s > STALE_S:
            self._complain(who, "stale_setpoints")

    def _command(self, now_s: float, who: str, message: Any, autopilot: Autopilot) -> None:
        if message.command not in _ACTS:
            return
        # Written out: no two NaN are the same.
        content = repr((message.command, message.param1, message.param2, message.param3))
        self._look_for_repeats(now_s, who, content)
        if message.command == CommandId.DO_SET_MODE:
            self._look_at_mode(now_s, who, message.param2, autopilot)
        elif message.command in _ENDS and autopilot.mode.is_external:
            self._senders[who].ordered_s = now_s
        disarms = message.command == CommandId.COMPONENT_ARM_DISARM and message.param1 == 0.0
        if disarms and message.param2 == FORCE and autopilot.armed and not autopilot.landed:
            self._complain(who, "stops_motors")

    def _look_for_repeats(self, now_s: float, who: str, content: str) -> None:
        sender = self._senders[who]
        times_s = sender.commands[content]
        # Older commands than the newest few do not matter.
        if len(sender.commands) > COMMANDS_KEPT:
            del sender.commands[next(iter(sender.commands))]
        times_s.append(now_s)
        while now_s - times_s[0] > SENT_AGAIN_S:
            times_s.popleft()
        if len(times_s) > SENT_AGAIN:
            self._complain(who, "repeats_commands")

    def _look_at_mode(self, now_s: float, who: str, number: float, autopilot: Autopilot) -> None:
        sender = self._senders[who]
        takes = number == autopilot.external_mode_number
        if autopilot.mode.is_external:
            sender.ordered_s = sender.ordered_s if takes else now_s
        elif takes and now_s - (sender.lost_control_s or -math.inf) < RETAKE_S:
            self._complain(who, "retakes_control")

    def _complain(self, who: str, kind: str) -> None:
        if not self.complaints[who][kind]:
            self._news.append(f"{who} {COMPLAINTS[kind]}")
        self.complaints[who][kind] += 1


_ACTS = frozenset(
    {
        CommandId.NAV_LOITER_UNLIM,
        CommandId.NAV_RETURN_TO_LAUNCH,
        CommandId.NAV_LAND,
        CommandId.NAV_TAKEOFF,
        CommandId.DO_SET_MODE,
        CommandId.DO_REPOSITION,
        CommandId.COMPONENT_ARM_DISARM,
    }
)
"""Commands that move the vehicle or change its mode."""
_ENDS = frozenset(
    {
        CommandId.NAV_LOITER_UNLIM,
        CommandId.NAV_RETURN_TO_LAUNCH,
        CommandId.NAV_LAND,
        CommandId.DO_REPOSITION,
    }
)
"""Commands by which a companion ends its own control."""


def _sane(message: Any) -> bool:
    """Return whether every value that is not masked out is a believable number."""
    mask = message.type_mask
    names = ("vx", "vy", "vz", "afx", "afy", "afz")
    values = [getattr(message, name) for bit, name in enumerate(names, 3) if not mask >> bit & 1]
    believable = all(abs(value) <= INSANE for value in values)  # a NaN compares false
    places = ("x", "y", "z") if hasattr(message, "x") else ("alt",)
    bits = (0, 1, 2) if len(places) == 3 else (2,)
    others = [getattr(message, n) for b, n in zip(bits, places, strict=True) if not mask >> b & 1]
    others += [getattr(message, n) for b, n in ((10, "yaw"), (11, "yaw_rate")) if not mask >> b & 1]
    return believable and all(map(math.isfinite, others))


def _leaves_axis_free(mask: int) -> bool:
    """Return whether an axis is controlled by neither position, velocity nor acceleration."""
    return bool(mask & mask >> 3 & mask >> 6 & 0b111)


def _moves(message: Any) -> bool:
    uses_velocity = message.type_mask >> 3 & 0b111 == 0
    return uses_velocity and math.hypot(message.vx, message.vy, message.vz) > STALE_MPS
