"""What stands between the control loop and any vehicle: values, and one protocol.

Three backends implement ``Vehicle``: ``companion.link.vehicle.MavlinkVehicle`` (a real
autopilot, or the mock on a socket) and ``sim.vehicle.SimVehicle`` (no wire, virtual time).
No MAVLink message passes this border: frames are local NED, units are SI, times are those of
the backend's own monotonic clock.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum, StrEnum
from typing import Protocol

from companion.arrays import FloatArray
from companion.world.frames import GeoPoint

FRAME_RESIDUAL_M = 1.0
"""Local and global position further apart than this are not of one frame."""


class FlightMode(StrEnum):
    """Flight modes as far as the companion tells them apart."""

    EXTERNAL = "external"
    """Setpoints from outside are obeyed: OFFBOARD on PX4, GUIDED on ArduPilot."""
    HOLD = "hold"
    """Stays where it is by itself: AUTO.LOITER on PX4, BRAKE or LOITER on ArduPilot."""
    TAKEOFF = "takeoff"
    LAND = "land"
    RETURN = "return"
    OTHER = "other"
    """Any other mode; somebody else is flying."""


class LandedState(IntEnum):
    """MAV_LANDED_STATE of EXTENDED_SYS_STATE."""

    UNKNOWN = 0
    ON_GROUND = 1
    IN_AIR = 2
    TAKING_OFF = 3
    LANDING = 4


class SystemStatus(IntEnum):
    """MAV_STATE of HEARTBEAT, the vehicle's and ours."""

    UNINIT = 0
    BOOT = 1
    CALIBRATING = 2
    STANDBY = 3
    ACTIVE = 4
    CRITICAL = 5
    EMERGENCY = 6
    POWEROFF = 7
    FLIGHT_TERMINATION = 8


class Severity(IntEnum):
    """MAV_SEVERITY of STATUSTEXT."""

    EMERGENCY = 0
    ALERT = 1
    CRITICAL = 2
    ERROR = 3
    WARNING = 4
    NOTICE = 5
    INFO = 6
    DEBUG = 7


@dataclass(frozen=True, slots=True)
class VehicleInfo:
    """Who the vehicle is; fixed once it is found."""

    system_id: int
    autopilot: str
    """``px4`` or ``ardupilot``."""
    version: str
    """Firmware version in words, empty where it is not known."""
    needs_stream_before_external: bool
    """PX4 wants setpoints before it enters OFFBOARD; ArduPilot's take-off dies of them."""
    earth_radius_m: float | None = None
    """Radius of the sphere on which it lays its local frame; ``None`` where that is exact."""


@dataclass(frozen=True, slots=True)
class VehicleState:
    """What is known of the vehicle at one instant; a consistent snapshot, never modified."""

    time_s: float
    """Arrival of the newest position, on the backend's monotonic clock."""
    position_ned_m: FloatArray
    """Relative to the autopilot's local origin, shape ``(3,)``."""
    velocity_ned_mps: FloatArray
    """Over ground, shape ``(3,)``."""
    attitude_rad: FloatArray
    """Roll, pitch, yaw, shape ``(3,)``; yaw clockwise from north."""
    heartbeat_time_s: float
    """Arrival of the newest HEARTBEAT."""
    mode: FlightMode
    mode_name: str
    """The firmware's own word, for people: ``OFFBOARD``, ``AUTO.LOITER``, ``GUIDED``."""
    armed: bool
    landed: LandedState
    system_status: SystemStatus
    ready_to_arm: bool
    """Pre-arm checks pass (SYS_STATUS PREARM_CHECK, or MAV_STATE past UNINIT)."""
    position_valid: bool
    """The estimator vouches for position and velocity."""
    origin: GeoPoint | None = None
    """The local origin (GPS_GLOBAL_ORIGIN), ``None`` until it was heard."""
    frame_epoch: int = 0
    """Rises when the origin moves or the estimator resets: the map must be tied again."""
    battery_fraction: float | None = None
    frame_residual_m: float | None = None
    """Distance between the local position and the global one seen from ``origin``; ``None``
    where they cannot be compared."""
    measured_s: float | None = None
    """When the position was made, by its time stamp, on our clock; ``None`` where none tells."""


class RequestKind(StrEnum):
    """What the companion may ask of a vehicle."""

    ARM = "arm"
    DISARM = "disarm"
    TAKEOFF = "take-off"
    EXTERNAL = "external mode"
    HOLD = "hold"
    LAND = "land"
    RETURN = "return"


class RequestState(StrEnum):
    """How far a request has come."""

    IDLE = "idle"
    PENDING = "pending"
    CONFIRMED = "confirmed"
    """Seen in the vehicle's own state (HEARTBEAT), not merely acknowledged."""
    REJECTED = "rejected"
    TIMED_OUT = "timed out"


@dataclass(frozen=True, slots=True)
class RequestStatus:
    """The newest request and its fate."""

    kind: RequestKind | None = None
    state: RequestState = RequestState.IDLE
    detail: str = ""
    """For people: the MAV_RESULT by name and what the vehicle said, if anything."""


@dataclass(frozen=True, slots=True)
class TargetReport:
    """One report of a target's position, as it came over the wire."""

    time_s: float
    """Arrival on the backend's monotonic clock."""
    system_id: int
    source: str
    """``GLOBAL_POSITION_INT`` or ``FOLLOW_TARGET``."""
    position: GeoPoint
    """WGS84; the altitude is above mean sea level."""
    velocity_ned_mps: FloatArray | None = None
    """Shape ``(3,)``, where the source gives one."""
    source_time_s: float | None = None
    """The sender's own clock, to tell a repeat from a new report."""


class EventKind(StrEnum):
    """What a vehicle reports besides its state."""

    STATUS_TEXT = "status text"
    FOREIGN_SETPOINT = "foreign setpoint"
    """Somebody else streams setpoints to our vehicle."""
    REBOOT = "reboot"
    """The autopilot's clock ran backwards."""
    COMMAND = "command"
    """A command addressed to us, and what it was answered."""
    LINK_ERROR = "link error"


@dataclass(frozen=True, slots=True)
class VehicleEvent:
    """Something that happened once."""

    time_s: float
    kind: EventKind
    text: str
    severity: Severity = Severity.INFO


class CommandKind(StrEnum):
    """What operators may ask of the companion itself."""

    REPOSITION = "DO_REPOSITION"
    PAUSE = "DO_PAUSE_CONTINUE 0"
    CONTINUE = "DO_PAUSE_CONTINUE 1"


class Verdict(IntEnum):
    """What a command comes to: MAV_RESULT of COMMAND_ACK."""

    ACCEPTED = 0
    NOT_NOW = 1
    """TEMPORARILY_REJECTED: the same may be accepted later."""
    DENIED = 2


@dataclass(frozen=True, slots=True)
class OperatorCommand:
    """A command addressed to the companion, its numbers already found to make sense."""

    kind: CommandKind
    sender: str
    """System and component id, ``255/190``."""
    position: GeoPoint | None = None
    """Of REPOSITION."""


@dataclass(frozen=True, slots=True)
class CommandAnswer:
    """The answer to one command."""

    verdict: Verdict
    words: str = ""
    """Why, for people."""


@dataclass(frozen=True, slots=True)
class LinkStats:
    """Counts since the link was opened."""

    packets_received: int = 0
    packets_lost: int = 0
    """Gaps in the vehicle's sequence numbers."""
    bytes_bad: int = 0
    """Bytes that belong to no valid packet."""
    packets_foreign: int = 0
    """Valid packets of systems that are neither the vehicle nor a target."""
    packets_refused: int = 0
    """Dropped on a signed link: not signed, another key, replayed, or old."""
    setpoints_sent: int = 0
    rates_hz: Mapping[str, float] = field(default_factory=dict)
    """Measured rate by message name, over the last seconds."""

    @property
    def loss_percent(self) -> float:
        """Return the share of the vehicle's packets that never arrived, in percent."""
        total = self.packets_received + self.packets_lost
        return 100.0 * self.packets_lost / total if total else 0.0


class Vehicle(Protocol):
    """What the loop needs of a vehicle, and of time. Only ``wait_until`` blocks."""

    @property
    def info(self) -> VehicleInfo:
        """Who it is."""
        ...

    def now_s(self) -> float:
        """Return the time of this backend's monotonic clock."""
        ...

    def wait_until(self, deadline_s: float) -> None:
        """Take in everything that arrives until ``deadline_s``, then return.

        Raises:
            LinkLostError: If the transport itself fails (a closed TCP stream, an unplugged
                serial port). Silence is no error here: ages tell.
        """
        ...

    def state(self) -> VehicleState | None:
        """Return the newest snapshot; ``None`` until position and heartbeat were heard."""
        ...

    def targets(self) -> Mapping[int, TargetReport]:
        """Return the newest report of every configured target, by system id."""
        ...

    def take_events(self) -> Sequence[VehicleEvent]:
        """Return what happened since the last call, oldest first, and forget it."""
        ...

    def send_velocity(self, velocity_ned_mps: FloatArray, yaw_rad: float | None = None) -> None:
        """Send exactly one velocity setpoint; it is never repeated.

        Args:
            velocity_ned_mps: Shape ``(3,)``, finite on every axis.
            yaw_rad: Heading to hold, clockwise from north; ``None`` leaves yaw to the autopilot.

        Raises:
            ValueError: If the velocity is not finite or not of shape ``(3,)``.
        """
        ...

    def request(self, kind: RequestKind, *, altitude_m: float | None = None) -> None:
        """Start asking for ``kind``; retries and time-outs run inside ``wait_until``.

        Args:
            kind: What to ask. A request still pending is dropped for the new one.
            altitude_m: For a take-off: height above the place of take-off.
        """
        ...

    def request_status(self) -> RequestStatus:
        """Return how far the newest request has come."""
        ...

    def judge_commands(self, judge: Callable[[OperatorCommand], CommandAnswer]) -> None:
        """Let ``judge`` answer every command addressed to us, inside ``wait_until``.

        Until then they are answered NOT_NOW.
        """
        ...

    def send_heartbeat(self, status: SystemStatus) -> None:
        """Send one HEARTBEAT with our own health; the loop calls this once a second."""
        ...

    def say(self, text: str, severity: Severity = Severity.INFO) -> None:
        """Send one STATUSTEXT."""
        ...

    def stats(self) -> LinkStats:
        """Return the counts of the link."""
        ...

    def close(self) -> None:
        """Release the transport; sends nothing."""
        ...
