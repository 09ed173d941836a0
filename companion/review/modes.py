"""Arming, flight modes and failsafes, each with who or what brought it about."""

from collections.abc import Callable, Mapping

from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.review.mode_names import obeys_setpoints
from companion.review.requests import Requests
from companion.review.story import Message, Story
from companion.vehicle import Severity

_ARMED = dialect.MAV_MODE_FLAG_SAFETY_ARMED
_FAILSAFE_S = 4.0
_CAUSE_S = 8.0
_STREAM_BACK_S = 3.0
_STREAMING_S = 0.5
_AFTER_LANDING_S = 15.0
_SILENCE_S = 3.5  # three HEARTBEATs
_STATUS = {
    dialect.MAV_STATE_CRITICAL: "CRITICAL",
    dialect.MAV_STATE_EMERGENCY: "EMERGENCY",
    dialect.MAV_STATE_FLIGHT_TERMINATION: "TERMINATION",
}


class Modes:
    """Follows the HEARTBEATs of the vehicle."""

    def __init__(self, story: Story, requests: Requests, mode_name: Callable[[int], str]) -> None:
        self._story = story
        self._requests = requests
        self._mode_name = mode_name
        self._mode: str | None = None
        self._last_s: float | None = None
        self._booting = False
        self.handlers: Mapping[int, Callable[[Message], None]] = {
            dialect.MAVLINK_MSG_ID_HEARTBEAT: self._heartbeat
        }

    def finish(self, end_s: float) -> None:
        """Tell how the log leaves the vehicle."""
        story = self._story
        if self._last_s is not None and end_s - self._last_s > _SILENCE_S:
            story.warn(end_s, f"the vehicle's HEARTBEAT is silent since {self._last_s:.1f} s")
        if story.armed:
            story.tell(end_s, "the log ends with the vehicle armed", Severity.NOTICE)

    def _heartbeat(self, message: Message) -> None:
        story, beat, now_s = self._story, message.fields, message.time_s
        if message.system_id != story.vehicle or beat.autopilot == dialect.MAV_AUTOPILOT_INVALID:
            return
        if self._last_s is not None and now_s - self._last_s > _SILENCE_S:
            story.warn(now_s, f"HEARTBEAT is back after {now_s - self._last_s:.1f} s of silence")
        self._last_s = now_s
        mode = self._mode_name(beat.custom_mode)
        armed = bool(beat.base_mode & _ARMED)
        status = _STATUS.get(beat.system_status, "")
        first = self._mode is None
        booting = beat.system_status == dialect.MAV_STATE_BOOT
        if booting and not first and not self._booting:
            story.warn(now_s, "the autopilot BOOTS: it has restarted")
        self._booting = booting
        was_armed, story.armed = story.armed, armed
        story.external = obeys_setpoints(mode)
        story.band("motors", now_s, "armed" if armed else "disarmed")
        story.band("mode", now_s, mode)
        if story.band("status", now_s, status or "ok") and (status or not first):
            words = (
                f"the autopilot reports {status}"
                if status
                else "the autopilot is no longer CRITICAL"
            )
            story.tell(now_s, words, Severity.CRITICAL if status else Severity.NOTICE)
            if status:
                story.failsafe_s = now_s
        if first:
            story.tell(now_s, f"the log begins in {mode}, {'armed' if armed else 'disarmed'}")
        elif armed != was_armed:
            self._tell_arming(now_s, armed)
        if not first and mode != self._mode:
            self._tell_mode(now_s, mode, disarming=was_armed and not armed)
        self._mode = mode

    def _tell_arming(self, now_s: float, armed: bool) -> None:
        story = self._story
        who = self._requests.who_asked_arm(armed, now_s)
        landed = story.landed_s is not None and now_s - story.landed_s < _AFTER_LANDING_S
        by = ", asked for by the pilot or by the autopilot itself: nobody on this link did"
        if who:
            by = f", asked for by {who}"
        elif landed and not armed:
            by = " by itself, after the landing"
        if not armed and story.in_air:
            story.warn(now_s, f"disarmed IN THE AIR{by}")
        else:
            story.tell(now_s, f"{'armed' if armed else 'disarmed'}{by}")

    def _tell_mode(self, now_s: float, mode: str, *, disarming: bool) -> None:
        story, before = self._story, self._mode or ""
        who = self._requests.who_asked_mode(mode, now_s)
        severity = Severity.NOTICE
        if who:
            reason = f"asked for by {who}"
            if obeys_setpoints(before):
                story.handed_over_s = now_s
        elif self._in_failsafe(now_s):
            reason, severity = "a FAILSAFE of the autopilot", Severity.WARNING
            story.failsafe_s = None
            if obeys_setpoints(before):
                reason += self._last_setpoint(now_s)
        elif disarming:
            reason = "after disarming"
        elif before.endswith("TAKEOFF"):
            reason = "the take-off is done"
        elif mode == "OFFBOARD" and self._stream_is_back(now_s):
            reason, severity = "BY ITSELF: setpoints flow again", Severity.WARNING
        else:
            reason = "nobody on this link asked: the pilot, someone else, or the autopilot"
            severity = Severity.WARNING if story.in_air else Severity.NOTICE
        story.tell(now_s, f"mode {before} -> {mode}: {reason}", severity)

    def _in_failsafe(self, now_s: float) -> bool:
        story = self._story
        spoke = story.failsafe_s is not None and 0.0 <= now_s - story.failsafe_s < _FAILSAFE_S
        return spoke or story.now("status") in _STATUS.values()

    def _last_setpoint(self, now_s: float) -> str:
        """Return what the stream of setpoints had to do with it."""
        last_s = self._story.setpoint_s
        if last_s is None:
            return ""
        since_s = now_s - last_s
        if since_s < _STREAMING_S:
            cause = self._story.last_warning(now_s - _CAUSE_S)
            if cause:
                return f", soon after this: {cause}"
            return (
                ", although setpoints were SENT all the time: they were lost on the way, or "
                "it is about something that this link does not tell"
            )
        return f", {since_s:.1f} s after the last setpoint"

    def _stream_is_back(self, now_s: float) -> bool:
        began_s = self._story.stream_began_s
        return began_s is not None and now_s - began_s < _STREAM_BACK_S
