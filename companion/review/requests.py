"""Who asked the vehicle for what, and what it answered."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.review.story import Message, Story
from companion.vehicle import Severity

_ANSWER_S = 3.0
_SLOW_S = 1.0
_REPEAT_S = 5.0  # a refusal that is repeated this fast is told once
_ACCEPTED = (dialect.MAV_RESULT_ACCEPTED, dialect.MAV_RESULT_IN_PROGRESS)
_TOLD = {
    dialect.MAV_CMD_COMPONENT_ARM_DISARM: "arm or disarm",
    dialect.MAV_CMD_DO_SET_MODE: "another mode",
    dialect.MAV_CMD_NAV_TAKEOFF: "take-off",
    dialect.MAV_CMD_NAV_LAND: "landing",
    dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH: "return to launch",
    dialect.MAV_CMD_NAV_LOITER_UNLIM: "loiter",
    dialect.MAV_CMD_MISSION_START: "the mission",
    dialect.MAV_CMD_DO_REPOSITION: "another position",
    dialect.MAV_CMD_DO_FLIGHTTERMINATION: "flight termination",
    dialect.MAV_CMD_DO_PARACHUTE: "the parachute",
    dialect.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: "reboot or shutdown",
    dialect.MAV_CMD_INJECT_FAILURE: "a simulated failure",
}
_LEADS_TO = {
    dialect.MAV_CMD_NAV_TAKEOFF: ("TAKEOFF",),
    dialect.MAV_CMD_NAV_LAND: ("LAND", "QLAND"),
    dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH: ("RTL", "QRTL"),
    dialect.MAV_CMD_NAV_LOITER_UNLIM: ("LOITER", "QLOITER"),
    dialect.MAV_CMD_MISSION_START: ("MISSION", "AUTO"),
    dialect.MAV_CMD_DO_REPOSITION: ("LOITER", "GUIDED"),
}
_FORCE = 21196  # param2 of COMPONENT_ARM_DISARM: whatever the checks say


@dataclass(frozen=True, slots=True)
class Request:
    """Something a sender asked of the vehicle."""

    time_s: float
    who: tuple[int, int]
    command: int
    """MAV_CMD."""
    mode: str = ""
    """The mode asked for."""
    arm: bool | None = None
    words: str = ""
    result: int | None = None
    """MAV_RESULT, ``None`` while there is no answer."""


class Requests:
    """Keeps the requests of the last seconds; tells those that were refused."""

    def __init__(self, story: Story, mode_name: Callable[[int], str], *, px4: bool) -> None:
        self._story = story
        self._mode_name = mode_name
        self._px4 = px4
        self._recent: list[Request] = []
        self._slowest = (0.0, 0.0, "")
        self._refused: dict[tuple[tuple[int, int], int, int], float] = {}
        self.handlers: Mapping[int, Callable[[Message], None]] = {
            dialect.MAVLINK_MSG_ID_COMMAND_LONG: self._long,
            dialect.MAVLINK_MSG_ID_COMMAND_INT: self._int,
            dialect.MAVLINK_MSG_ID_SET_MODE: self._set_mode,
            dialect.MAVLINK_MSG_ID_COMMAND_ACK: self._answer,
        }

    def who_asked_mode(self, mode: str, now_s: float) -> str:
        """Return who asked for ``mode`` lately, empty if nobody did."""
        for request in reversed(self._lately(now_s)):
            last = mode.rpartition(".")[2]
            if request.mode == mode or last in _LEADS_TO.get(request.command, ()):
                return self._story.who(*request.who)
        return ""

    def who_asked_arm(self, arm: bool, now_s: float) -> str:
        """Return who asked to arm, or to disarm, lately, empty if nobody did."""
        for request in reversed(self._lately(now_s)):
            if request.arm is arm:
                return self._story.who(*request.who)
        return ""

    def finish(self, end_s: float) -> None:
        """Tell what never was answered, and how late the latest answer was."""
        self._forget(end_s)
        late_s, at_s, words = self._slowest
        if late_s > _SLOW_S:
            self._story.warn(at_s, f"answers come LATE: {late_s:.1f} s to that to {words}")

    def _lately(self, now_s: float) -> list[Request]:
        return [
            request
            for request in self._recent
            if now_s - request.time_s < _ANSWER_S
            and (request.result is None or request.result in _ACCEPTED)
        ]

    def _long(self, message: Message) -> None:
        fields = message.fields
        self._ask(message, (fields.param1, fields.param2, fields.param3, fields.param7))

    def _int(self, message: Message) -> None:
        fields = message.fields
        self._ask(message, (fields.param1, fields.param2, fields.param3, fields.z))

    def _ask(self, message: Message, params: tuple[float, float, float, float]) -> None:
        fields, story = message.fields, self._story
        if story.is_autopilot(message):
            return
        if fields.target_system not in (0, story.vehicle) or fields.command not in _TOLD:
            return
        command = int(fields.command)
        words, mode, arm = _TOLD[command], "", None
        if command == dialect.MAV_CMD_COMPONENT_ARM_DISARM:
            arm = params[0] == 1.0
            words = ("arm" if arm else "disarm") + (", by force" if params[1] == _FORCE else "")
        elif command == dialect.MAV_CMD_DO_SET_MODE:
            mode = self._mode_name(self._mode_number(params))
            words = f"mode {mode}"
        elif command == dialect.MAV_CMD_NAV_TAKEOFF and not self._px4:
            words = f"take-off to {params[3]:g} m"
        request = Request(
            message.time_s,
            (message.system_id, message.component_id),
            command,
            mode,
            arm,
            words,
        )
        if command not in (
            dialect.MAV_CMD_COMPONENT_ARM_DISARM,
            dialect.MAV_CMD_DO_SET_MODE,
        ) and not any(known.words == words for known in self._lately(message.time_s)):
            who = story.who(*request.who)
            story.tell(message.time_s, f"{who} asks for {words}")
        self._add(request)

    def _mode_number(self, params: tuple[float, float, float, float]) -> int:
        _, main, sub, _ = (int(value) if abs(value) < 1e6 else 0 for value in params)
        return main << 16 | sub << 24 if self._px4 else main

    def _set_mode(self, message: Message) -> None:
        if message.fields.target_system in (0, self._story.vehicle):
            mode = self._mode_name(message.fields.custom_mode)
            who = (message.system_id, message.component_id)
            command = dialect.MAV_CMD_DO_SET_MODE
            self._add(Request(message.time_s, who, command, mode, None, f"mode {mode}"))

    def _add(self, request: Request) -> None:
        self._forget(request.time_s)
        self._recent = [
            known
            for known in self._recent
            if (known.who, known.command, known.words)
            != (request.who, request.command, request.words)
        ]
        self._recent.append(request)

    def _forget(self, now_s: float) -> None:
        """Drop what is old; an arming or mode request without any answer is told."""
        for request in self._recent:
            if now_s - request.time_s >= _ANSWER_S and request.result is None:
                who = self._story.who(*request.who)
                if request.command != dialect.MAV_CMD_DO_SET_MODE:
                    text = f"no answer to {who}, who asked for {request.words}"
                    self._story.warn(request.time_s + _ANSWER_S, text)
        self._recent = [request for request in self._recent if now_s - request.time_s < _ANSWER_S]

    def _answer(self, message: Message) -> None:
        fields, story = message.fields, self._story
        if message.system_id != story.vehicle:
            return
        for index, request in enumerate(self._recent):
            if request.command != fields.command:
                continue
            if fields.target_system and (fields.target_system, fields.target_component) not in (
                request.who,
                (request.who[0], 0),
            ):
                continue
            self._recent[index] = replace(request, result=int(fields.result))
            if request.result is None:
                late_s = message.time_s - request.time_s
                self._slowest = max(self._slowest, (late_s, message.time_s, request.words))
            key = (request.who, request.command, int(fields.result))
            told_s = self._refused.get(key, -_REPEAT_S)
            if fields.result not in _ACCEPTED and message.time_s - told_s >= _REPEAT_S:
                self._refused[key] = message.time_s
                result = dialect.enums["MAV_RESULT"].get(fields.result)
                reason = (
                    f"result {fields.result}"
                    if result is None
                    else result.name[11:].lower().replace("_", " ")
                )
                who = story.who(*request.who)
                severity = Severity.WARNING if story.in_air else Severity.NOTICE
                story.tell(message.time_s, f"refused: {request.words}, {who} ({reason})", severity)
