"""When this program itself was away (swapped out, stopped, starved), or the link was.

While it was away nothing was sent, or nothing arrived, and whoever has the vehicle now has it
rightly. PX4 leaves OFFBOARD after a second without setpoints and would take it back by itself if
the stream simply went on, even from a pilot: after a long absence there is silence until a
HEARTBEAT tells.
"""

from enum import Enum, auto

from companion.guidance.limits import CATCH_UP_S, KNOWN_MODE_S, STALL_S, STREAM_GAP_S
from companion.vehicle import VehicleState


class Returning(Enum):
    """What to do after an absence."""

    GO_ON = auto()
    LOOK = auto()
    """Take in what came meanwhile before anything moves; the stream need not stop."""
    SILENT = auto()
    """Send nothing: the mode is not known."""
    LOST = auto()
    """No HEARTBEAT came for too long: give up."""


class Absence:
    """Notices absences of the control loop by the times of its ticks."""

    def __init__(self, now_s: float) -> None:
        self._updated_s = now_s
        self._caught_up_s = now_s
        self._silent_since_s: float | None = None

    def tick(self, now_s: float) -> float:
        """Note a tick; return how long after the last one it came."""
        gap_s, self._updated_s = now_s - self._updated_s, now_s
        return gap_s

    def returning(self, gap_s: float, now_s: float, v: VehicleState) -> Returning:
        """Return what to do in this tick, which came ``gap_s`` after the last."""
        if gap_s > STALL_S:
            self._caught_up_s = now_s + CATCH_UP_S
        if gap_s > STREAM_GAP_S:
            self._silent_since_s = now_s
        if self._silent_since_s is not None:
            if v.heartbeat_time_s <= self._silent_since_s:
                waited_s = now_s - self._silent_since_s
                return Returning.LOST if waited_s > 2 * KNOWN_MODE_S else Returning.SILENT
            self._silent_since_s = None
        return Returning.LOOK if now_s < self._caught_up_s else Returning.GO_ON


class Silence:
    """Notices that nothing was heard of the vehicle for so long that others may have it."""

    def __init__(self) -> None:
        self._unheard_s: float | None = None

    def mode_unknown(self, now_s: float, v: VehicleState) -> bool:
        """Return whether no HEARTBEAT has told the mode since a silence; asked in every tick."""
        if now_s - max(v.time_s, v.heartbeat_time_s) > STREAM_GAP_S:
            self._unheard_s = now_s
        return self._unheard_s is not None and v.heartbeat_time_s <= self._unheard_s
