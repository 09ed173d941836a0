"""What the flying process hands to the recorder: plain values, and their bytes on the pipe.

Every record is a tagged msgspec struct, sent as msgpack behind a four-byte length. Vectors are
plain lists (``array.tolist()``) in the map frame: ENU metres, origin at the map's south-west
ground corner. Times are seconds since the start of the session.
"""

from collections.abc import Mapping
from typing import Any, Literal

import msgspec

from companion.session.summary import Summary
from companion.vehicle import Severity
from companion.world.maps import Map

Source = Literal["autopilot", "companion", "review"]
"""Who says it; ``review`` is what was found in the frames afterwards."""


class MapRecord(msgspec.Struct, frozen=True):
    """The map as far as it is drawn."""

    name: str
    size_m: list[float]
    """East, north and up, shape ``(3,)``."""
    footprints_m: list[list[list[float]]] = []
    """One ring of ``[east, north]`` vertices for each obstacle."""
    heights_m: list[float] = []
    names: list[str] = []
    content_hash: str = ""
    origin: list[float] | None = None
    """South-west ground corner on earth: latitude, longitude (deg), altitude (m)."""


def map_record(city: Map) -> MapRecord:
    """Return what is drawn of a map."""
    origin = city.origin
    return MapRecord(
        name=city.name,
        size_m=city.size_m.tolist(),
        footprints_m=[footprint_m.tolist() for footprint_m in city.footprints_m],
        heights_m=city.heights_m.tolist(),
        names=list(city.obstacle_names),
        content_hash=city.content_hash,
        origin=None
        if origin is None
        else [origin.latitude_deg, origin.longitude_deg, origin.altitude_m],
    )


class ActorRecord(msgspec.Struct, frozen=True):
    """Which actor flew."""

    name: str
    sha256: str = ""
    layout: str = ""
    columns: list[str] = []
    """Names of the observation's columns."""
    detail: dict[str, Any] = {}
    """What else of the contract is worth showing: preset, seed, evaluation results."""


class VehicleRecord(msgspec.Struct, frozen=True):
    """Which vehicle was flown, and over what."""

    system_id: int
    autopilot: str
    version: str = ""
    link: str = ""
    """The URL the link was opened with."""


class SessionStart(msgspec.Struct, frozen=True, kw_only=True, array_like=True, tag="start"):
    """The first record of a session: everything that does not change in it."""

    session_id: str
    start_utc_us: int
    """Wall-clock time at ``time_s == 0``, microseconds since 1970."""
    map: MapRecord
    actor: ActorRecord
    vehicle: VehicleRecord
    config: dict[str, Any]
    """The effective configuration, as in ``config.json``."""
    v_max_mps: float
    margin_m: float
    """Clearance that the shield keeps."""
    arrival_radius_m: float
    made_by: str = ""
    """Versions of this program and of what its arithmetic depends on."""


class Tick(msgspec.Struct, frozen=True, kw_only=True, array_like=True, gc=False, tag="tick"):
    """One turn of the control loop; what was not known at that tick is ``None``."""

    time_s: float
    position_enu_m: list[float] | None = None
    velocity_enu_mps: list[float] | None = None
    attitude_rad: list[float] | None = None
    """Roll, pitch, yaw as in MAVLink ATTITUDE: yaw clockwise from north."""
    target_enu_m: list[float] | None = None
    target_velocity_enu_mps: list[float] | None = None
    target_tier: str = ""
    """How far the target can be trusted: fresh, coast, hold, lost."""
    observation: list[float] | None = None
    action: list[float] | None = None
    """What the actor returned, normalised to [-1, 1], shape ``(3,)``."""
    spherical: list[float] | None = None
    """The same scaled: rho (fraction of the edge), phi (rad), psi (rad)."""
    proposed_enu_mps: list[float] | None = None
    """Velocity the policy asks for."""
    safe_enu_mps: list[float] | None = None
    """Velocity that was sent; ``None`` where nothing was."""
    clearance_m: float | None = None
    distance_m: float | None = None
    """To the target."""
    shield_reason: str = ""
    intervened: bool = False
    """Whether the shield changed the proposed velocity."""
    supervisor: str = ""
    mode: str = ""
    """The firmware's own word."""
    armed: bool = False
    battery_fraction: float | None = None
    link_age_s: float | None = None
    position_age_s: float | None = None
    target_age_s: float | None = None
    latency_ms: float | None = None
    """From the arrival of the position to the setpoint on the wire."""
    lateness_ms: float | None = None
    """Of this tick behind its deadline."""
    rates_hz: Mapping[str, float] | None = None
    """Measured rate by message name; once a second is enough."""
    speed_cap_mps: float | None = None
    """Lowered because something was not as in training; ``None`` for ``v_max_mps``."""
    drift_enu_mps: list[float] | None = None
    """Of the velocity, what no command explains; ``None`` for nothing."""
    gust_mps: float = 0.0
    """The strongest drift of late."""


class Raw(msgspec.Struct, frozen=True, array_like=True, gc=False, tag="raw"):
    """One MAVLink frame as it crossed the link."""

    sent: bool
    """By us; else received."""
    time_s: float
    data: bytes


class Inputs(msgspec.Struct, frozen=True, array_like=True, gc=False, tag="inputs"):
    """A block of ``companion.journal``: what the flying process was told, in order."""

    number: int
    """Of this block, from 0; a gap is a block that was lost."""
    frames: int
    """``Raw`` records before this block; fewer in ``flight.tlog`` means that some were lost."""
    data: bytes


class Event(msgspec.Struct, frozen=True, array_like=True, gc=False, tag="event"):
    """Something worth a line in the log."""

    time_s: float
    severity: Severity
    source: Source
    text: str


class Mark(msgspec.Struct, frozen=True, array_like=True, tag="mark"):
    """A place on the map worth a label: the closest approach, the take-over."""

    label: str
    position_enu_m: list[float]


class SessionEnd(msgspec.Struct, frozen=True, array_like=True, tag="end"):
    """The last record of a session that ended in order."""

    summary: Summary


Record = SessionStart | Tick | Raw | Inputs | Event | Mark | SessionEnd

_LENGTH_BYTES = 4


def _plain(value: Any) -> Any:
    """Turn numpy arrays and scalars into lists and floats; msgspec asks for the rest."""
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"a record cannot hold {type(value).__name__}")


_ENCODER = msgspec.msgpack.Encoder(enc_hook=_plain)


def encode_record(record: Record) -> bytes:
    """Return the bytes of one record, length first.

    Raises:
        TypeError: If the record holds something that is not plain data.
    """
    data = _ENCODER.encode(record)
    return len(data).to_bytes(_LENGTH_BYTES, "big") + data


class RecordReader:
    """Cut a stream of bytes back into records. Bytes in any portions; no I/O here."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._decoder = msgspec.msgpack.Decoder(Record)

    def feed(self, data: bytes) -> list[Record]:
        """Return the records that ``data`` completes; the beginning of the next is kept.

        Raises:
            msgspec.DecodeError: If the bytes are not those of ``encode_record``.
        """
        self._buffer += data
        records: list[Record] = []
        start = 0
        while len(self._buffer) - start >= _LENGTH_BYTES:
            body = start + _LENGTH_BYTES
            end = body + int.from_bytes(self._buffer[start:body], "big")
            if end > len(self._buffer):
                break
            records.append(self._decoder.decode(bytes(self._buffer[body:end])))
            start = end
        del self._buffer[:start]
        return records
