"""``companion run``: builds the objects of one flight, flies, and writes down how it ended."""

import contextlib
import gc
import logging
import os
import signal
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import msgspec

from companion import clock
from companion.computer import ComputerProbe
from companion.config import RunConfig
from companion.errors import UsageError
from companion.guidance.limits import ARRIVAL_RADIUS_M
from companion.hastening import HastenedTransport, hastened_clock
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
    Tick,
    VehicleRecord,
    map_record,
)
from companion.session.summary import Summary
from companion.watchdog import Watchdog

RECORDER_CLOSE_S = 20.0
RECORDER_HURRY_S = 1.0
"""After a second signal, or one that comes while the recorder finishes."""
_PROBE_BYTES = 1 << 16
_TIMER_SLACK = Path("/proc/self/timerslack_ns")
_LOG = logging.getLogger("companion")


def run(config: RunConfig) -> Summary:
    """Fly as ``config`` says and return the summary; the session folder is complete then.

    Raises:
        CompanionError: If the flight is refused or cannot begin; nothing has moved.
    """
    city, actor = load_files(config)
    _check_writable(config.record)
    start_utc = clock.utc_now()
    early: list[Record] = []
    sinks: list[Callable[[Record], None]] = [early.append]
    speed = config.mock_speed
    journal = Journal(lambda record: sinks[-1](record), hastened_clock(speed))

    with link_url(
        config.connect, config.map, config.target_sysid, config.signing_key, speed=speed
    ) as url:
        vehicle = connect(
            url,
            vehicle_sysid=config.vehicle_sysid,
            target_sysids=target_sysids(config),
            timeout_s=CONNECT_TIMEOUT_S,
            backend=config.backend,
            signing_key=config.signing_key,
            tap=journal.tap,
            watch=lambda transport: JournaledTransport(
                transport if speed == 1.0 else HastenedTransport(transport, speed), journal
            ),
            now=journal.now,
            utc_now=lambda: start_utc,
            computer=journal.computer(ComputerProbe().read),
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
            with (
                _Signals(patience=1) as signals,
                Watchdog(os.environ, process_id=os.getpid()) as watchdog,
            ):
                gc.collect()
                gc.freeze()
                _wake_on_time()
                summary = fly(
                    vehicle,
                    config,
                    city,
                    actor,
                    cap,
                    record=_watched(recorder),
                    stop_requested=journal.stop(lambda: signals.count > 0),
                    start_s=journal.start_s,
                    alive=watchdog.alive,
                )
    journal.flush()
    summary = msgspec.structs.replace(summary, session_dir=str(folder), v_max_mps=cap.v_max_mps)
    _finish(recorder, folder, summary, in_a_hurry=signals.count > 1)
    return summary


def _wake_on_time() -> None:
    """Have Linux end our waits when they are over, not up to 0.05 ms later."""
    with contextlib.suppress(OSError):
        _TIMER_SLACK.write_text("1")


class _Signals:
    """Counts SIGINT, SIGTERM and SIGHUP; one more than ``patience`` interrupts what runs."""

    def __init__(self, patience: int) -> None:
        self.count = 0
        self._patience = patience
        self._before: dict[int, Any] = {}

    def __enter__(self) -> "_Signals":
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            self._before[number] = signal.signal(number, self._take)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _take(self, _number: int, _frame: FrameType | None) -> None:
        self.count += 1
        if self.count > self._patience:
            raise KeyboardInterrupt


def _finish(recorder: Recorder, folder: Path, summary: Summary, *, in_a_hurry: bool) -> None:
    """Write the summary and wait for the recorder, which goes on by itself if nobody does."""
    finished = False
    with contextlib.suppress(KeyboardInterrupt), _Signals(patience=0):
        recorder.put(SessionEnd(summary))
        _write(lambda: write_summary(folder, summary), folder)
        finished = recorder.close(RECORDER_HURRY_S if in_a_hurry else RECORDER_CLOSE_S)
    if not finished:
        _LOG.warning("the recorder has not finished yet; %s may be incomplete", folder)
    for message in recorder.take_messages():
        _LOG.info("recorder: %s", message)


def _check_writable(parent: Path) -> None:
    """Refuse a place for recordings that takes none, before anything is opened.

    Raises:
        UsageError: If nothing can be written there: no rights, read-only, full.
    """
    try:
        parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=parent) as probe:
            probe.write(bytes(_PROBE_BYTES))
    except FileExistsError:
        raise UsageError(f"--record {parent} is a file, give a folder") from None
    except OSError as error:
        raise UsageError(f"cannot write to --record {parent}: {error.strerror}") from error


def _watched(recorder: Recorder) -> Callable[[Record], None]:
    """Return ``recorder.put`` that says what the recorder says, and once that it has died."""
    said: list[bool] = []

    def put(record: Record) -> None:
        recorder.put(record)
        if not isinstance(record, Tick):  # once a turn of the loop is enough
            return
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
