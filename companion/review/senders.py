"""Who speaks in a log: the vehicle, its companions, ground stations, other vehicles."""

from collections import Counter
from dataclasses import dataclass, field

from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.errors import UsageError
from companion.review.log_file import LogFile

_FIRMWARE = {dialect.MAV_AUTOPILOT_PX4: "px4", dialect.MAV_AUTOPILOT_ARDUPILOTMEGA: "ardupilot"}
_HEARTBEAT = dialect.MAVLINK_MSG_ID_HEARTBEAT
_KINDS = {
    dialect.MAV_TYPE_GCS: "ground station",
    dialect.MAV_TYPE_ONBOARD_CONTROLLER: "companion",
    dialect.MAV_TYPE_GIMBAL: "gimbal",
    dialect.MAV_TYPE_CAMERA: "camera",
    dialect.MAV_TYPE_ANTENNA_TRACKER: "antenna tracker",
}
_LOWEST_GROUND_STATION = 240  # system ids by custom, where no HEARTBEAT tells


@dataclass
class Senders:
    """Everybody in a log, and which of them is the vehicle."""

    vehicle: int
    """System id of the autopilot that is heard most."""
    component: int
    """Its component id, 1 as a rule."""
    firmware: str
    """``px4``, ``ardupilot`` or empty."""
    vehicle_type: int
    """MAV_TYPE."""
    others: list[int]
    """System ids of further autopilots."""
    kinds: dict[tuple[int, int], int] = field(default_factory=dict)
    """MAV_TYPE of everybody who sent a HEARTBEAT."""

    def name(self, system_id: int, component_id: int) -> str:
        """Return who that is, for people: ``companion 1/191``."""
        ids = f"{system_id}/{component_id}"
        if (system_id, component_id) == (self.vehicle, self.component):
            return "the autopilot"
        kind = _KINDS.get(self.kinds.get((system_id, component_id), -1))
        if kind is None and system_id >= _LOWEST_GROUND_STATION:
            kind = "ground station"
        return ids if kind is None else f"{kind} {ids}"

    @property
    def type_name(self) -> str:
        """Return the kind of vehicle: ``quadrotor``."""
        entry = dialect.enums["MAV_TYPE"].get(self.vehicle_type)
        return "vehicle" if entry is None else entry.name[9:].lower().replace("_", " ")


def find_senders(log: LogFile) -> Senders:
    """Look through the HEARTBEATs of a log.

    Raises:
        UsageError: If there is no autopilot in it.
    """
    decoder = dialect.MAVLink(None)
    heard: Counter[int] = Counter()
    firmware: dict[int, tuple[int, int, int]] = {}
    kinds: dict[tuple[int, int], int] = {}
    seen: set[int] = set()
    for frame in log.frames():
        seen.add(frame.system_id)
        if frame.message_id != _HEARTBEAT:
            continue
        try:
            heartbeat = decoder.decode(bytearray(frame.data))
        except dialect.MAVError:
            continue
        kinds[frame.system_id, frame.component_id] = heartbeat.type
        if heartbeat.autopilot != dialect.MAV_AUTOPILOT_INVALID and heartbeat.type not in _KINDS:
            heard[frame.system_id] += 1
            firmware[frame.system_id] = (
                frame.component_id,
                heartbeat.autopilot,
                heartbeat.type,
            )
    if not heard:
        who = ", ".join(map(str, sorted(seen)[:8]))
        raise UsageError(f"{log.path} has no HEARTBEAT of an autopilot, only of systems {who}")
    (vehicle, _), *others = heard.most_common()
    component, autopilot, vehicle_type = firmware[vehicle]
    return Senders(
        vehicle,
        component,
        _FIRMWARE.get(autopilot, ""),
        vehicle_type,
        sorted(other for other, _ in others),
        kinds,
    )
