"""What the supervisor is told and what it answers: plain values, one tick each."""

from dataclasses import dataclass
from enum import StrEnum

from companion.guidance.reasons import Reason
from companion.guidance.target import TargetTier
from companion.vehicle import RequestKind, RequestStatus, SystemStatus, VehicleState


class Phase(StrEnum):
    """States of the supervisor; the value is what the log and the viewer show."""

    PREFLIGHT = "preflight"
    READY = "ready"
    ARMING = "arming"
    TAKING_OFF = "taking off"
    ENGAGING = "engaging"
    ENGAGED = "engaged"
    HOLDING = "holding"
    HANDING_OVER = "handing over"
    STOOD_DOWN = "stood down"
    DONE = "done"


class Stream(StrEnum):
    """What may leave for the vehicle in this tick."""

    NOTHING = "nothing"
    ZERO = "zero"
    """Zero and nothing else: the vehicle is not ours yet, or nobody knows where it is."""
    HOLD = "hold"
    """Zero as the shield lets it: it leans against what would carry the vehicle into things."""
    POLICY = "policy"


class Outcome(StrEnum):
    """How a run ended."""

    ARRIVED = "arrived"
    STOPPED = "stopped"
    """By a signal to the program."""
    STOOD_DOWN = "stood_down"
    LINK_LOST = "link_lost"
    TARGET_LOST = "target_lost"
    POSITION_LOST = "position_lost"
    """The vehicle does not know where it is, or we do not know where that is on the map."""
    REFUSED = "refused"
    COMMAND_FAILED = "command_failed"
    STUCK = "stuck"
    BATTERY_LOW = "battery_low"
    FAILED = "failed"


EXIT_CODES = {
    Outcome.ARRIVED: 0,
    Outcome.STOPPED: 130,
    Outcome.STOOD_DOWN: 7,
    Outcome.LINK_LOST: 4,
    Outcome.TARGET_LOST: 4,
    Outcome.POSITION_LOST: 4,
    Outcome.REFUSED: 5,
    Outcome.COMMAND_FAILED: 6,
    Outcome.STUCK: 6,
    Outcome.BATTERY_LOW: 5,
    Outcome.FAILED: 8,
}


@dataclass(frozen=True, slots=True)
class Plan:
    """What the operator has allowed; everything is off unless asked for."""

    engage: bool = False
    """Ask for OFFBOARD / GUIDED instead of waiting for the pilot."""
    arm: bool = False
    takeoff_m: float | None = None
    on_exit: RequestKind | None = RequestKind.HOLD
    """What to ask for at the end; ``None`` just stops the stream."""
    shadow: bool = False
    """Decide and record, never send."""
    stream_before_external: bool = True
    """``VehicleInfo.needs_stream_before_external``: PX4's order, not ArduPilot's."""


@dataclass(frozen=True, slots=True)
class Situation:
    """Everything one decision depends on."""

    now_s: float
    vehicle: VehicleState | None
    request: RequestStatus
    target: TargetTier
    target_age_s: float = 0.0
    distance_m: float | None = None
    target_moving: bool = False
    target_changed: bool = False
    """Somebody has sent us another target."""
    target_off_map_m: float = 0.0
    """How far outside the box of the map the target is; 0 inside."""
    arrived: bool = False
    height_m: float = 0.0
    """Above the place of take-off."""
    waiting_for: str = ""
    """What preflight still misses; empty when nothing."""
    refusal: str = ""
    """Why this flight must not start at all; empty when it may."""
    foreign_setpoint: str = ""
    """Who else sends setpoints to our vehicle; empty when nobody."""
    rebooted: bool = False
    position_frozen: bool = False
    """The position stands still to the last bit while the vehicle moves, or is to move."""
    off_map_m: float = 0.0
    """How far outside the box of the map the vehicle is; 0 inside."""
    frame_moved: bool = False
    frame_untied: str = ""
    """How local and global position contradict each other; empty when they agree."""
    policy_failures: int = 0
    """Policy outputs in a row that were not usable."""
    stop_requested: bool = False
    """By a signal to the program."""
    paused_by: str = ""
    """Who has sent us DO_PAUSE_CONTINUE; empty when nobody."""


@dataclass(frozen=True, slots=True)
class Directive:
    """The decision of one tick."""

    phase: Phase
    stream: Stream
    reason: str
    """Why the supervisor is in this phase, in words."""
    code: Reason = Reason.STARTED
    """The same for scripts."""
    request: RequestKind | None = None
    """To be started in this tick."""
    outcome: Outcome | None = None
    """Set once the run is over."""

    @property
    def health(self) -> SystemStatus:
        """Return the MAV_STATE that our HEARTBEAT shows."""
        return _HEALTH[self.phase]


_HEALTH = {
    Phase.PREFLIGHT: SystemStatus.BOOT,
    Phase.READY: SystemStatus.STANDBY,
    Phase.ARMING: SystemStatus.ACTIVE,
    Phase.TAKING_OFF: SystemStatus.ACTIVE,
    Phase.ENGAGING: SystemStatus.ACTIVE,
    Phase.ENGAGED: SystemStatus.ACTIVE,
    Phase.HOLDING: SystemStatus.CRITICAL,
    Phase.HANDING_OVER: SystemStatus.EMERGENCY,
    Phase.STOOD_DOWN: SystemStatus.STANDBY,
    Phase.DONE: SystemStatus.STANDBY,
}
