"""``companion run``: builds the objects of one flight, flies, and writes down how it ended."""

import contextlib
import gc
import logging
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType

import msgspec

from companion import clock
from companion.config import RunConfig
from companion.control import ARRIVAL_RADIUS_M
from companion.journal import Journal, JournaledTransport
from companion.launch import CONNECT_TIMEOUT_S, fly, load_files, speed_cap, target_sysids
from companion.link.opening import connect
from companion.mock_process import link_url
from companion.recording import actor_record, made_by
from companion.session.folder import create_session_folder, write_config, write_summary
from companion.session.recorder import Recorder
from companion.session.records import (
    Record,
    SessionEnd,
    SessionStart,
    VehicleRecord,
    map_record,
)
from companion.session.summary import Summary

RECORDER_CLOSE_S = 20.0
_LOG = logging.getLogger("companion")


def run(config: RunConfig) -> Summary:
    """Fly as ``config`` says and return the summary; the session folder is complete then.

    Raises:
        CompanionError: If the flight is refused or cannot begin; nothing has moved.
    """
    city, actor = load_files(config)
    start_utc = clock.utc_now()
    early: list[Record] = []
    sinks: list[Callable[[Record], None]] = [early.append]
    journal = Journal(lambda record: sinks[-1](record))

    with link_url(config.connect, config.map, config.target_sysid) as url:
        vehicle = connect(
            url,
            vehicle_sysid=config.vehicle_sysid,
            target_sysids=target_sysids(config),
            timeout_s=CONNECT_TIMEOUT_S,
            backend=config.backend,
            signing_key=config.signing_key,
            tap=journal.tap,
            watch=lambda transport: JournaledTransport(transport, journal),
            now=journal.now,
            utc_now=lambda: start_utc,
        )
        with contextlib.closing(vehicle):
            cap = speed_cap(vehicle, config)
            folder = create_session_folder(config.record, start_utc)
            _write(lambda: write_config(folder, config.as_dict()), folder)
            recorder = Recorder(folder, live=config.rerun)
            recorder.put(
                SessionStart(
                    session_id=folder.name,
                    start_utc_us=round(start_utc.timestamp() * 1e6),
                    map=map_record(city),
                    actor=actor_record(actor),
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
                    made_by=made_by(),
                )
            )
            for record in early:
                recorder.put(record)
            sinks.append(recorder.put)
            with _stop_flag() as stop_requested:
                gc.collect()
                gc.freeze()
                summary = fly(
                    vehicle,
                    config,
                    city,
                    actor,
                    cap,
                    record=_watched(recorder),
                    stop_requested=journal.stop(stop_requested),
                    start_s=journal.start_s,
                )
    journal.flush()
    summary = msgspec.structs.replace(summary, session_dir=str(folder), v_max_mps=cap.v_max_mps)
    recorder.put(SessionEnd(summary))
    _write(lambda: write_summary(folder, summary), folder)
    if not recorder.close(RECORDER_CLOSE_S):
        _LOG.warning("the recorder did not finish; %s may be incomplete", folder)
    for message in recorder.take_messages():
        _LOG.info("recorder: %s", message)
    return summary


@contextlib.contextmanager
def _stop_flag() -> Iterator[Callable[[], bool]]:
    """Turn the first SIGINT, SIGTERM or SIGHUP into a flag; the second ends the program at once."""
    asked: list[int] = []

    def on_signal(number: int, _frame: FrameType | None) -> None:
        if asked:
            raise KeyboardInterrupt
        asked.append(number)

    before = {
        number: signal.signal(number, on_signal)
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
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
