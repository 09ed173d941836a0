"""Opens whatever is given as a flight: a session folder, a recording, a telemetry log."""

import os
import tempfile
from pathlib import Path
from typing import Any

import msgspec

from companion.errors import MapError, UsageError
from companion.review.log_flight import log_flight
from companion.review.log_story import read_story
from companion.session import viewer
from companion.session.flight import Flight
from companion.session.folder import CONFIG, RECORDING, SUMMARY, TLOG
from companion.session.report import facts, result_line
from companion.session.summary import Summary
from companion.world.maps import load_map

MENDED = "mended"
"""Part of the name of a copy that ``review`` makes of a recording that was cut off."""
_FOOTER_MAGIC, _FOOTER_BYTES = b"RRF2FOOT", 16  # at the end of every Rerun file that was closed
_SHOWN = ("map", "actor", "target", "target_global", "target_sysid", "v_max", "margin", "rate_hz")


_OF_THE_LOG = (
    *("In the air", "Highest above take-off", "Longest setpoint gap", "Battery"),
    *("Velocity error", "Velocity lag"),
)
"""What the frames tell that no summary does."""


def open_flight(path: Path, map_name: str | None = None) -> Flight:
    """Read what there is about a flight.

    Args:
        path: A session folder, a recording (``.rrd``), or any telemetry log.
        map_name: Map over which a log is laid; a session without recording knows its own.

    Raises:
        UsageError: If it is none of these, or cannot be read.
        MapError: If the map cannot be used, or the log cannot be placed on it.
    """
    if path.is_dir():
        return _open_session(path, map_name)
    if not path.exists():
        raise UsageError(f"there is no {path}")
    if path.suffix == ".rrd":
        recording = whole_recording(path)
        flight = _read_recording(recording)
        flight.path = path
        return _with_summary(flight, flight.summary)
    return log_flight(read_story(path), None if map_name is None else load_map(map_name))


def check_session(session: Path) -> None:
    """Raise ``UsageError`` unless ``session`` is the folder of a session."""
    if not session.is_dir():
        raise UsageError(f"{session} is not a folder; give one that `companion run` has made")
    if not any((session / name).exists() for name in (RECORDING, TLOG, SUMMARY)):
        raise UsageError(f"{session} is not a session: it has no {RECORDING}, {TLOG} or {SUMMARY}")


def read_summary(session: Path) -> Summary | None:
    """Read ``summary.json``; ``None`` if the run was cut off before it was written.

    Raises:
        UsageError: If it is damaged.
    """
    path = session / SUMMARY
    try:
        return msgspec.json.decode(path.read_bytes(), type=Summary)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror}") from error
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise UsageError(f"{path} is damaged: {error}") from error


def read_settings(session: Path) -> list[tuple[str, str]]:
    """Return what of ``config.json`` is worth showing.

    Raises:
        UsageError: If it is damaged.
    """
    path = session / CONFIG
    try:
        config = msgspec.json.decode(path.read_bytes(), type=dict[str, Any])
    except FileNotFoundError:
        return []
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror}") from error
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise UsageError(f"{path} is damaged: {error}") from error
    return [(name, str(value)) for name, value in config.items() if name in _SHOWN and value]


def files_of(session: Path) -> list[tuple[str, str]]:
    """Return the large files of a session, each with its size and use."""
    rows = []
    for name, what in ((RECORDING, "open it with `companion review`"), (TLOG, "raw MAVLink")):
        path = session / name
        size = f"{path.stat().st_size / 1e6:.1f} MB, {what}" if path.exists() else "missing"
        rows.append((name, size))
    return rows


def whole_recording(recording: Path) -> Path:
    """Return the recording; of one that is cut off, or still written to, a whole copy.

    Raises:
        UsageError: If there is nothing in it, or it is no recording.
    """
    recording = recording.resolve()
    if recording.stat().st_size == 0:
        raise UsageError(f"{recording} is empty: the run ended before anything was recorded")
    with recording.open("rb") as file:
        file.seek(max(0, recording.stat().st_size - _FOOTER_BYTES))
        if _FOOTER_MAGIC in file.read():
            return recording
    mended = recording.with_suffix(f".{MENDED}.rrd")
    if not os.access(recording.parent, os.W_OK):
        mended = Path(tempfile.mkdtemp(prefix="companion-review-")) / mended.name
    if not viewer.optimize(recording, mended):
        raise UsageError(f"{recording} is cut off or not a recording, and cannot be mended")
    return mended


def _open_session(session: Path, map_name: str | None) -> Flight:
    check_session(session)
    summary = read_summary(session)
    log, recording = session / TLOG, session / RECORDING
    flight = Flight(path=session, title=session.name, result="")
    has_log = log.exists() and log.stat().st_size > 0
    problem = ""
    if recording.exists():
        try:
            flight = _read_recording(whole_recording(recording))
        except UsageError as error:
            if not has_log:
                raise
            problem = str(error)
    if flight.recording is None and has_log:
        flight = _log_of_session(session, map_name)
    flight.path, flight.title = session, session.resolve().name
    flight.settings = [
        *(row for row in flight.facts if row[0] == "Vehicle"),
        *(read_settings(session) or flight.settings),
    ]
    if problem:
        flight.settings.append((RECORDING, f"{problem}; this is read from {TLOG}"))
    if flight.recording is not None:
        flight.facts = []
        _add_story(flight, log)
    flight = _with_summary(flight, summary)
    if summary is None:
        flight.result = f"unknown: there is no {SUMMARY}, so the run was cut off"
    return flight


def _log_of_session(session: Path, map_name: str | None) -> Flight:
    """Read the frames of a session, on the map that was flown if it is still there."""
    story = read_story(session / TLOG)
    name = map_name or dict(read_settings(session)).get("map")
    try:
        return log_flight(story, None if name is None else load_map(name))
    except MapError:
        if map_name is not None:
            raise
        return log_flight(story)


def _read_recording(recording: Path) -> Flight:
    viewer.viewer_binary()
    from companion.session.readback import read_recording

    return read_recording(recording)


def _add_story(flight: Flight, log: Path) -> None:
    """Add what the raw frames tell beyond what the companion itself has noticed."""
    try:
        story = read_story(log)
    except UsageError:  # no log, or nothing in it: the recording is what there is
        return
    late_s = (story.start_utc_us - flight.start_utc_us) / 1e6 if flight.start_utc_us else 0.0
    flight.events += [
        msgspec.structs.replace(event, time_s=event.time_s + late_s)
        for event in story.events
        if event.source == "review"
    ]
    flight.events.sort(key=lambda event: event.time_s)
    for name in ("gps", "estimator", "link", "status", "geofence", "contacts"):
        if name in story.story.bands:
            changes = story.story.bands[name]
            flight.bands[name] = [(time_s + late_s, word) for time_s, word in changes]
    flight.facts += [row for row in story.story.facts if row[0] in _OF_THE_LOG]


def _with_summary(flight: Flight, summary: Summary | None) -> Flight:
    if summary is not None:
        flight.summary = summary
        flight.result = result_line(summary)
        ours = facts(summary)
        names = {name for name, _ in ours}
        flight.facts = [*ours, *(row for row in flight.facts if row[0] not in names)]
    return flight
