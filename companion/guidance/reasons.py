"""Why the supervisor is where it is: one code for every transition.

The code stands in the log line, in STATUSTEXT, in the recording and in the summary
(``reason_code``), beside the words. Scripts may rely on it; the words are for people.
"""

from enum import StrEnum


class Reason(StrEnum):
    """What led to a transition of the supervisor."""

    STARTED = "started"
    WAITING = "waiting"
    """Something that preflight needs has not come yet, or the pilot has not acted yet."""
    NOT_READY = "not_ready"
    """What preflight waited for did not come in time."""
    SITE = "site"
    """Map, vehicle and target do not fit each other."""
    PREFLIGHT_PASSED = "preflight_passed"
    ASKED = "asked"
    """A request of ours to the vehicle is under way."""
    AT_HEIGHT = "at_height"
    REJECTED = "rejected"
    """The vehicle refused a request of ours."""
    NO_ANSWER = "no_answer"
    """The vehicle did not answer a request of ours, or did not do what it accepted."""
    CLIMB_STOPPED = "climb_stopped"
    """Somebody stopped the take-off that we had asked for."""
    ENGAGED = "engaged"
    RESUMED = "resumed"

    MODE_CHANGED = "mode_changed"
    FAILSAFE = "failsafe"
    """The autopilot shows MAV_STATE_CRITICAL or worse."""
    DISARMED = "disarmed"
    FOREIGN_SETPOINT = "foreign_setpoint"
    REBOOT = "reboot"
    STATE_GONE = "state_gone"

    SIGNAL = "signal"
    PAUSED = "paused"
    """DO_PAUSE_CONTINUE, addressed to us."""

    LINK_SILENT = "link_silent"
    HEARTBEAT_LATE = "heartbeat_late"
    """Without one nobody knows who has the vehicle."""
    LINK_FAILED = "link_failed"
    """The transport itself: a TCP stream was closed, a serial port unplugged."""
    STALL = "stall"
    """This program was away too long to know who has the vehicle."""
    POSITION_LATE = "position_late"
    POSITION_INVALID = "position_invalid"
    """The autopilot's estimator does not vouch for it."""
    FRAME_MOVED = "frame_moved"
    """The estimator was reset or the local origin moved: the map is tied anew."""
    FRAME_UNTIED = "frame_untied"
    """Local and global position contradict each other, or an origin is missing."""
    TARGET_SILENT = "target_silent"
    POLICY_UNUSABLE = "policy_unusable"
    BATTERY_LOW = "battery_low"
    NO_PROGRESS = "no_progress"
    ARRIVED = "arrived"
    USAGE = "usage"
    REFUSED = "refused"
    """Before there was a flight: file, map, actor or vehicle cannot be used."""
    INTERNAL = "internal"
    """An error of this program."""
