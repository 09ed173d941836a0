"""``companion run``: builds the objects of one flight, flies, and writes down how it ended."""

import contextlib
import gc
import logging
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import msgspec

from companion import clock
from companion.config import V_MAX_LOW_MPS, RunConfig
from companion.control import ARRIVAL_RADIUS_M, Flight, Mission
from companion.errors import LinkLostError, RefusedError
from companion.guidance.failsafe import SpeedCap, failsafe_of, parameters_wanted
from companion.guidance.shield import Shield, ShieldLimits
from companion.guidance.situation import Outcome, Plan
from companion.link.opening import connect
from companion.link.vehicle import MavlinkVehicle
from companion.mock_process import link_url
from companion.policy.actor import Actor
from companion.positions import TargetSource
from companion.preflight import target_problem
from companion.session.folder import create_session_folder, write_config, write_summary
from companion.session.recorder import Recorder
from companion.session.records import (
    ActorRecord,
    Event,
    Raw,
    Record,
    SessionEnd,
    SessionStart,
    VehicleRecord,
    map_record,
)
from companion.session.summary import Summary
from companion.vehicle import RequestKind, Severity
from companion.world.maps import Map, load_map

CONNECT_TIMEOUT_S = 10.0
PARAMETERS_TIMEOUT_S = 1.5
RECORDER_CLOSE_S = 20.0
_ON_EXIT = {
    "hold": RequestKind.HOLD,
    "land": RequestKind.LAND,
    "rtl": RequestKind.RETURN,
    "none": None,
}
_LOG = logging.getLogger("companion")


def run(config: RunConfig) -> Summary:
    """Fly as ``config`` says and return the summary; the session folder is complete then.

    Raises:
        CompanionError: If the flight is refused or cannot begin; nothing has moved.
    """
    config.check()
    city = load_map(config.map)
    actor = Actor.load(config.actor)
    actor.check_fits(city, config.v_max)
    target = TargetSource(config.target_enu_m(), config.target_geodetic(), config.target_sysid)
    if target.position_enu_m is not None:
        problem = target_problem(city, target.position_enu_m)
        if problem:
            raise RefusedError(problem)
    if city.origin is None and city.launch_enu_m is None:
        raise RefusedError(f"map {city.name} has neither origin nor launch_m: it cannot be flown")

    early: list[Raw] = []
    taps: list[Callable[[Record], None]] = []
    start_s, start_utc = clock.now_s(), clock.utc_now()

    def tap(sent: bool, time_s: float, data: bytes) -> None:
        record = Raw(sent, time_s - start_s, data)
        if taps:
            taps[0](record)
        else:
            early.append(record)

    with link_url(config.connect, config.map, config.target_sysid) as url:
        vehicle = connect(
            url,
            vehicle_sysid=config.vehicle_sysid,
            target_sysids=[] if config.target_sysid is None else [config.target_sysid],
            timeout_s=CONNECT_TIMEOUT_S,
            backend=config.backend,
            signing_key=config.signing_key,
            tap=tap,
        )
        with contextlib.closing(vehicle):
            cap = _speed_cap(vehicle, config)
            folder = create_session_folder(config.record, start_utc)
            _write(lambda: write_config(folder, config.as_dict()), folder)
            recorder = Recorder(folder, live=config.rerun)
            recorder.put(
                SessionStart(
                    session_id=folder.name,
                    start_utc_us=round(start_utc.timestamp() * 1e6),
                    map=map_record(city),
                    actor=_actor_record(actor),
                    vehicle=VehicleRecord(
                        system_id=vehicle.info.system_id,
                        autopilot=vehicle.info.autopilot,
                        version=vehicle.info.version,
                        link=url,
                    ),
                    config=config.as_dict(),
                    v_max_mps=cap.v_max_mps,
                    margin_m=config.margin,
                    arrival_radius_m=ARRIVAL_RADIUS_M,
                )
            )
            for record in early:
                recorder.put(record)
            taps.append(recorder.put)
            severity = Severity.WARNING if cap.exceeds else Severity.INFO
            recorder.put(Event(clock.now_s() - start_s, severity, "companion", cap.words))
            summary = _fly(vehicle, config, city, actor, target, cap.v_max_mps, recorder, start_s)
    summary = msgspec.structs.replace(summary, session_dir=str(folder), v_max_mps=cap.v_max_mps)
    recorder.put(SessionEnd(summary))
    _write(lambda: write_summary(folder, summary), folder)
    if not recorder.close(RECORDER_CLOSE_S):
        _LOG.warning("the recorder did not finish; %s may be incomplete", folder)
    for message in recorder.take_messages():
        _LOG.info("recorder: %s", message)
    return summary


def _speed_cap(vehicle: MavlinkVehicle, config: RunConfig) -> SpeedCap:
    """Return the speed to fly with, from what the vehicle would do without us; say it once.

    Raises:
        RefusedError: If no speed that is worth flying keeps blind travel within the margin.
    """
    autopilot = vehicle.info.autopilot
    parameters = vehicle.read_params(parameters_wanted(autopilot), PARAMETERS_TIMEOUT_S)
    failsafe = failsafe_of(autopilot, parameters)
    cap = failsafe.cap(config.v_max, config.margin, obey=config.cap_by_failsafe)
    if cap.v_max_mps < V_MAX_LOW_MPS:
        raise RefusedError(f"{cap.words}; too slow to fly: raise --margin or shorten the time-out")
    _LOG.info("%s", failsafe.sentence)
    if failsafe.assumed:
        _LOG.info("not read, defaults assumed: %s", ", ".join(failsafe.assumed))
    _LOG.log(logging.WARNING if cap.exceeds else logging.INFO, "%s", cap.words)
    return cap


def _fly(
    vehicle: MavlinkVehicle,
    config: RunConfig,
    city: Map,
    actor: Actor,
    target: TargetSource,
    v_max_mps: float,
    recorder: Recorder,
    start_s: float,
) -> Summary:
    info = vehicle.info
    _LOG.info("vehicle %d: %s %s", info.system_id, info.autopilot, info.version)
    if city.origin is None:
        _LOG.warning(
            "map %s has no place on earth: the vehicle's local origin is taken to be at %s m",
            city.name,
            [] if city.launch_enu_m is None else city.launch_enu_m.tolist(),
        )
    plan = Plan(
        engage=config.engage,
        arm=config.arm,
        takeoff_m=config.takeoff,
        on_exit=_ON_EXIT[config.on_exit],
        shadow=config.shadow,
        stream_before_external=info.needs_stream_before_external,
    )
    mission = Mission(city, actor, plan, target, v_max_mps, config.rate_hz)
    limits = ShieldLimits(
        v_max_mps=v_max_mps, margin_m=config.margin, period_s=1.0 / config.rate_hz
    )
    shield = Shield(city, limits)
    with _stop_flag() as stop_requested:
        flight = Flight(
            vehicle,
            mission,
            shield,
            record=_watched(recorder),
            stop_requested=stop_requested,
            session_start_s=start_s,
        )
        gc.collect()
        gc.freeze()
        try:
            return flight.run()
        except LinkLostError as error:
            return flight.finish(Outcome.LINK_LOST, str(error))
        except Exception:
            _LOG.exception("internal error in the control loop; asking the vehicle to hold")
            flight.abandon()
            return flight.finish(Outcome.FAILED, "internal error in the control loop")


@contextlib.contextmanager
def _stop_flag() -> Iterator[Callable[[], bool]]:
    """Turn the first SIGINT or SIGTERM into a flag; the second one ends the program at once."""
    asked: list[int] = []

    def on_signal(number: int, _frame: FrameType | None) -> None:
        if asked:
            raise KeyboardInterrupt
        asked.append(number)

    before = {
        number: signal.signal(number, on_signal) for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield lambda: bool(asked)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _watched(recorder: Recorder) -> Callable[[Record], None]:
    """Return ``recorder.put`` that says what the recorder says, and once that it has died."""
    said: list[bool] = []

    def put(record: Record) -> None:
        recorder.put(record)
        for message in recorder.take_messages():
            _LOG.info("recorder: %s", message)
        if not recorder.alive and not said:
            said.append(True)
            _LOG.warning("the recorder has died; the flight goes on without a recording")

    return put


def _write(write: Callable[[], None], folder: Path) -> None:
    try:
        write()
    except OSError as error:
        _LOG.warning("cannot write to %s: %s", folder, error.strerror)


def _actor_record(actor: Actor) -> ActorRecord:
    contract = actor.contract
    detail: dict[str, Any] = {
        "preset": contract.preset,
        "stage": contract.stage,
        "seed": contract.seed,
    }
    return ActorRecord(
        name=actor.name,
        sha256=actor.sha256,
        layout=contract.layout.name,
        columns=list(contract.layout.columns),
        detail=detail,
    )
