"""``companion preflight``: looks at a vehicle for a few seconds and judges it.

Sends nothing but heartbeats and requests for data. The reasons are those of ``preflight``, which
the control loop refuses by as well.
"""

import contextlib
import math
from dataclasses import dataclass, field

import msgspec
import numpy as np

from companion.arrays import FloatArray
from companion.config import PreflightConfig
from companion.errors import RefusedError
from companion.guidance.failsafe import failsafe_of, parameters_wanted
from companion.guidance.target import TargetEstimate
from companion.link.opening import connect
from companion.link.vehicle import MavlinkVehicle
from companion.mock_process import link_url
from companion.positions import Pose, Positions, TargetSource, loose_tie
from companion.preflight import (
    refusal,
    target_problem,
    target_warning,
    unhealthy,
    untimely,
    waiting_for,
)
from companion.vehicle import EventKind, SystemStatus, VehicleEvent, VehicleState
from companion.world.frames import GeoPoint
from companion.world.maps import Map, load_map

CONNECT_TIMEOUT_S = 10.0
PARAMETERS_TIMEOUT_S = 2.0
LISTEN_S = 5.0
_SAMPLE_S = 0.05
_HEARTBEAT_S = 1.0
_SETTLE_S = 2.5
"""Ages are measured after this: the streams asked for have begun, one window of rates is over."""
_POSITION = "LOCAL_POSITION_NED"


class Inspection(msgspec.Struct, frozen=True, kw_only=True):
    """What was seen of a vehicle, and the verdict; ``None`` where nothing was heard."""

    go: bool
    reasons: list[str]
    """Why not; empty when it is GO."""
    warnings: list[str] = []
    """What a pilot should know all the same."""
    exit_code: int = 0
    link: str = ""
    system_id: int | None = None
    autopilot: str = ""
    version: str = ""
    mode: str = ""
    armed: bool | None = None
    landed: str = ""
    ready_to_arm: bool | None = None
    battery_fraction: float | None = None
    position_rate_hz: float | None = None
    position_age_max_s: float | None = None
    heartbeat_age_max_s: float | None = None
    link_loss_percent: float | None = None
    rates_hz: dict[str, float] = {}
    position_valid: bool | None = None
    local_origin: list[float] | None = None
    """Latitude, longitude (deg), altitude above mean sea level (m)."""
    tie_residual_m: float | None = None
    """Between LOCAL_POSITION_NED and GLOBAL_POSITION_INT; ``None``: not checked."""
    map: str = ""
    position_enu_m: list[float] | None = None
    target_enu_m: list[float] | None = None
    target_distance_m: float | None = None
    parameters: dict[str, int | float] = {}
    assumed: list[str] = []
    """Parameters that did not answer; their documented defaults were taken."""
    failsafe: str = ""
    failsafe_notes: list[str] = []
    v_max_mps: float | None = None
    margin_m: float | None = None
    blind_travel_m: float | None = None
    v_max_safe_mps: float | None = None


def inspect(config: PreflightConfig) -> Inspection:
    """Connect, listen, read, judge.

    Raises:
        CompanionError: If the options make no sense, or no vehicle can be found on the link.
    """
    config.check()
    city = load_map(config.map)
    if city.origin is None and city.launch_enu_m is None:
        raise RefusedError(f"map {city.name} has neither origin nor launch_m: it cannot be flown")
    with link_url(config.connect, config.map, config.target_sysid, config.signing_key) as url:
        vehicle = connect(
            url,
            vehicle_sysid=config.vehicle_sysid,
            target_sysids=[] if config.target_sysid is None else [config.target_sysid],
            timeout_s=CONNECT_TIMEOUT_S,
            backend=config.backend,
            signing_key=config.signing_key,
        )
        with contextlib.closing(vehicle):
            parameters = vehicle.read_params(
                parameters_wanted(vehicle.info.autopilot), PARAMETERS_TIMEOUT_S
            )
            return _judge(config, city, url, vehicle, parameters, _listen(vehicle, config, city))


@dataclass(slots=True)
class _Heard:
    """What came in while listening."""

    source: TargetSource
    target: TargetEstimate
    state: VehicleState | None = None
    pose: Pose | None = None
    position_age_max_s: float = 0.0
    heartbeat_age_max_s: float = 0.0
    residuals_m: list[float] = field(default_factory=list)
    events: list[VehicleEvent] = field(default_factory=list)
    frame_moved: bool = False


def _listen(vehicle: MavlinkVehicle, config: PreflightConfig, city: Map) -> _Heard:
    source = TargetSource(config.target_enu_m(), config.target_geodetic(), config.target_sysid)
    positions = Positions(city, source, earth_radius_m=vehicle.info.earth_radius_m)
    start_s = heartbeat_s = now_s = vehicle.now_s()
    heard = _Heard(source, positions.target(now_s))
    while now_s < start_s + LISTEN_S:
        if now_s >= heartbeat_s:
            heartbeat_s += _HEARTBEAT_S
            vehicle.send_heartbeat(SystemStatus.BOOT)
            if vehicle.global_position() is None:
                vehicle.request_global_position()
        vehicle.wait_until(now_s + _SAMPLE_S)
        now_s, state = vehicle.now_s(), vehicle.state()
        heard.events += vehicle.take_events()
        heard.pose = positions.update(state, vehicle.targets())
        heard.frame_moved |= positions.take_frame_moved()
        heard.state, heard.target = state, positions.target(now_s)
        if state is not None and now_s - start_s > _SETTLE_S:
            heard.position_age_max_s = max(heard.position_age_max_s, now_s - state.time_s)
            age_s = now_s - state.heartbeat_time_s
            heard.heartbeat_age_max_s = max(heard.heartbeat_age_max_s, age_s)
        reported = vehicle.global_position()
        place = None if reported is None else positions.on_map(reported.position)
        if heard.pose is not None and place is not None:
            heard.residuals_m.append(float(np.linalg.norm(place - heard.pose.position_enu_m)))
    return heard


def _judge(
    config: PreflightConfig,
    city: Map,
    url: str,
    vehicle: MavlinkVehicle,
    parameters: dict[str, int | float],
    heard: _Heard,
) -> Inspection:
    info, stats, state = vehicle.info, vehicle.stats(), heard.state
    failsafe = failsafe_of(info.autopilot, parameters, info.version)
    cap = failsafe.cap(config.v_max, config.margin, obey=False)
    residual_m = float(np.median(heard.residuals_m)) if heard.residuals_m else None
    rate_hz = stats.rates_hz.get(_POSITION, 0.0)
    reasons = _reasons(config, city, heard, rate_hz, residual_m)
    seen = Inspection(
        go=not reasons,
        reasons=reasons,
        exit_code=RefusedError.exit_code if reasons else 0,
        warnings=[
            *_near_obstacles(config, city, heard.target),
            *_warnings(city, cap.words if cap.exceeds else "", failsafe.assumed, residual_m),
        ],
        link=url,
        system_id=info.system_id,
        autopilot=info.autopilot,
        version=info.version,
        position_rate_hz=round(rate_hz, 1),
        link_loss_percent=round(stats.loss_percent, 2),
        rates_hz={name: round(rate, 1) for name, rate in sorted(stats.rates_hz.items())},
        tie_residual_m=_rounded(residual_m),
        map=city.name,
        parameters=parameters,
        assumed=list(failsafe.assumed),
        failsafe=failsafe.sentence,
        failsafe_notes=list(failsafe.notes),
        v_max_mps=config.v_max,
        margin_m=config.margin,
        blind_travel_m=_rounded(failsafe.blind_travel_m(config.v_max)),
        v_max_safe_mps=_rounded(failsafe.v_max_safe_mps(config.margin)),
        target_enu_m=_list(heard.target.position_enu_m),
    )
    if state is not None:
        seen = msgspec.structs.replace(
            seen,
            mode=state.mode_name,
            armed=state.armed,
            landed=state.landed.name.lower().replace("_", " "),
            ready_to_arm=state.ready_to_arm,
            battery_fraction=state.battery_fraction,
            position_valid=state.position_valid,
            position_age_max_s=_rounded(heard.position_age_max_s),
            heartbeat_age_max_s=_rounded(heard.heartbeat_age_max_s),
            local_origin=None if state.origin is None else _degrees_and_metres(state.origin),
        )
    if heard.pose is not None:
        place = heard.pose.position_enu_m
        distance_m = None
        if heard.target.position_enu_m is not None:
            distance_m = math.dist(place, heard.target.position_enu_m)
        seen = msgspec.structs.replace(
            seen, position_enu_m=_list(place), target_distance_m=_rounded(distance_m)
        )
    return seen


def _reasons(
    config: PreflightConfig,
    city: Map,
    heard: _Heard,
    rate_hz: float,
    residual_m: float | None,
) -> list[str]:
    """Return everything that stands against a flight, the most basic first."""
    missing = waiting_for(city, heard.state, heard.pose, heard.source, heard.target)
    refused = refusal(
        city, heard.pose, heard.target, takeoff_m=config.takeoff, margin_m=config.margin
    )
    if heard.pose is None and heard.source.position_enu_m is not None:
        refused = target_problem(city, heard.source.position_enu_m, config.margin)
    reasons = [missing, refused, loose_tie(residual_m)]
    if heard.state is not None:
        reasons += [untimely(rate_hz, heard.position_age_max_s), *unhealthy(heard.state)]
    if heard.frame_moved:
        reasons.append("the local frame moved while it was looked at")
    reasons += {
        f"{event.text}: somebody else steers it"
        for event in heard.events
        if event.kind is EventKind.FOREIGN_SETPOINT
    }
    reasons += {event.text for event in heard.events if event.kind is EventKind.REBOOT}
    return [reason for reason in reasons if reason]


def _near_obstacles(config: PreflightConfig, city: Map, target: TargetEstimate) -> list[str]:
    """Return that a target which stands still can be flown to, but not quite."""
    place = target.position_enu_m
    if place is None or target.velocity_enu_mps.any():
        return []
    if target_problem(city, place, config.margin):
        return []
    warning = target_warning(city, place, config.margin)
    return [warning] if warning else []


def _warnings(
    city: Map, blind: str, assumed: tuple[str, ...], residual_m: float | None
) -> list[str]:
    warnings = [blind] if blind else []
    if assumed:
        warnings.append(f"not read, defaults assumed: {', '.join(assumed)}")
    if city.origin is None:
        warnings.append(
            f"map {city.name} has no place on earth: the local origin is taken to be at its launch"
        )
    if residual_m is None:
        warnings.append("no GLOBAL_POSITION_INT: the frame tie is not checked against it")
    return warnings


def _degrees_and_metres(point: GeoPoint) -> list[float]:
    return [
        round(point.latitude_deg, 7),
        round(point.longitude_deg, 7),
        round(point.altitude_m, 3),
    ]


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 3)


def _list(values: FloatArray | None) -> list[float] | None:
    return None if values is None else [round(float(value), 3) + 0.0 for value in values]
