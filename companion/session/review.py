"""Read a session back: the report in words, the recording in the viewer, a picture of it."""

import shlex
import tempfile
from pathlib import Path
from typing import Any

import msgspec

from companion.errors import CompanionError, UsageError
from companion.session import viewer
from companion.session.folder import CONFIG, RECORDING, SUMMARY, TLOG
from companion.session.records import map_record
from companion.session.report import facts
from companion.session.summary import Summary
from companion.table import row
from companion.world.maps import Map

MENDED = "session.mended.rrd"
"""A copy of a recording that was cut off, made by ``review``."""
_FOOTER_MAGIC, _FOOTER_BYTES = b"RRF2FOOT", 16  # at the end of every Rerun file that was closed
_SHOWN = ("map", "actor", "target", "target_global", "target_sysid", "v_max", "margin", "rate_hz")


def review(session: Path) -> str:
    """Return the report of a session, to be read at 80 columns.

    Raises:
        UsageError: If ``session`` is not the folder of a session.
        CompanionError: If a file in it cannot be understood.
    """
    check_session(session)
    lines = [f"Session {session}"]
    summary = _read_summary(session)
    if summary is None:
        lines += row("Result", f"unknown: there is no {SUMMARY}, so the run was cut off")
    else:
        outcome = summary.outcome.replace("_", " ")
        lines += row("Result", f"{outcome} (exit code {summary.exit_code}): {summary.reason}")
        lines += [line for name, value in facts(summary) for line in row(name, value)]
    for name, value in _read_config(session).items():
        if name in _SHOWN and value is not None:
            lines += row(name, str(value))
    for name, what in ((RECORDING, "open it with `companion review`"), (TLOG, "raw MAVLink")):
        path = session / name
        size = f"{path.stat().st_size / 1e6:.1f} MB, {what}" if path.exists() else "missing"
        lines += row(name, size)
    return "\n".join(lines)


def open_viewer(session: Path) -> str:
    """Open the recording in a viewer of its own and return what was done, a line or two.

    Without a display nothing is opened, and the line says how to open the recording elsewhere.

    Raises:
        UsageError: If there is no recording, or Rerun is not installed.
    """
    recording = _recording(session)
    if not viewer.has_display():
        return (
            "no display here: copy the recording to a desk and open it there with\n"
            f"  rerun {shlex.quote(str(recording))}"
        )
    viewer.open_viewer(str(recording))
    return f"opened {recording}"


def render_png(
    session: Path, png: Path, *, at_s: float | None = None, size: tuple[int, int] = (1920, 1080)
) -> None:
    """Render the recording into a picture, without a display.

    Args:
        session: The folder of the session.
        png: The picture; overwritten.
        at_s: Time of the picture since the start of the session; its end, if not given.
        size: Width and height in pixels.

    Raises:
        UsageError: If there is no recording, or Rerun is not installed.
        CompanionError: If the recording is unreadable or the viewer cannot start here.
    """
    recording = _recording(session)
    if not png.parent.is_dir():
        raise UsageError(f"cannot write {png}: there is no folder {png.parent}")
    from companion.session.picture import render

    render(recording, png, at_s=at_s, size=size)


def show_map(city: Map) -> str:
    """Open a map in the viewer and return what was done.

    Raises:
        UsageError: If there is no display, or Rerun is not installed.
    """
    if not viewer.has_display():
        raise UsageError("there is no display here to show the map on")
    viewer.viewer_binary()
    from companion.session.streams import write_map

    recording = Path(tempfile.mkdtemp(prefix="companion-map-")) / f"{city.name}.rrd"
    write_map(recording, map_record(city))
    viewer.open_viewer(str(recording))
    return f"opened {recording}"


def check_session(session: Path) -> None:
    """Raise ``UsageError`` unless ``session`` is the folder of a session."""
    if not session.is_dir():
        raise UsageError(f"{session} is not a folder; give one that `companion run` has made")
    if not any((session / name).exists() for name in (RECORDING, TLOG, SUMMARY)):
        raise UsageError(f"{session} is not a session: it has no {RECORDING}, {TLOG} or {SUMMARY}")


def _recording(session: Path) -> Path:
    """Return the recording; of one that is cut off, or still written to, a whole copy."""
    check_session(session)
    recording = session.resolve() / RECORDING
    if not recording.exists():
        raise UsageError(f"{session} has no {RECORDING}: it was recorded without Rerun")
    if recording.stat().st_size == 0:
        raise CompanionError(f"{recording} is empty: the run ended before anything was recorded")
    if _is_whole(recording):
        return recording
    mended = recording.with_name(MENDED)
    if not viewer.optimize(recording, mended):
        raise CompanionError(f"{recording} is cut off or not a recording, and cannot be mended")
    return mended


def _is_whole(recording: Path) -> bool:
    with recording.open("rb") as file:
        file.seek(max(0, recording.stat().st_size - _FOOTER_BYTES))
        return _FOOTER_MAGIC in file.read()


def _read_summary(session: Path) -> Summary | None:
    path = session / SUMMARY
    try:
        return msgspec.json.decode(path.read_bytes(), type=Summary)
    except FileNotFoundError:
        return None
    except (OSError, msgspec.DecodeError) as error:
        raise CompanionError(f"cannot read {path}: {error}") from error


def _read_config(session: Path) -> dict[str, Any]:
    path = session / CONFIG
    try:
        return msgspec.json.decode(path.read_bytes(), type=dict[str, Any])
    except FileNotFoundError:
        return {}
    except (OSError, msgspec.DecodeError) as error:
        raise CompanionError(f"cannot read {path}: {error}") from error
