"""The review in words, to be read at 80 columns: how it ended, what stands out, what happened."""

import textwrap
from pathlib import Path

from companion.review.findings import findings, is_grave
from companion.review.sources import (
    check_session,
    files_of,
    read_settings,
    read_summary,
)
from companion.session.flight import Flight
from companion.session.folder import SUMMARY
from companion.session.records import Event
from companion.session.report import facts, result_line
from companion.table import row

_WIDTH = 80
_INDENT = 14


def brief(session: Path) -> str:
    """Return how a session ended: what ``run`` prints. Reads the two small files only.

    Raises:
        UsageError: If it is not the folder of a session, or a file in it is damaged.
    """
    check_session(session)
    summary = read_summary(session)
    lines = [f"Session {session}"]
    if summary is None:
        lines += row("Result", f"unknown: there is no {SUMMARY}, so the run was cut off")
    else:
        lines += row("Result", result_line(summary))
    rows = [] if summary is None else facts(summary)
    for name, value in (*rows, *read_settings(session), *files_of(session)):
        lines += row(name, value)
    return "\n".join(lines)


def report(flight: Flight) -> str:
    """Return the whole review of a flight."""
    kind = "Session" if flight.path.is_dir() else "Log" if flight.recording is None else "Recording"
    lines = [f"{kind} {flight.path}", *row("Result", flight.result)]
    rows = [*flight.facts, *flight.settings]
    if flight.path.is_dir():
        rows += files_of(flight.path)
    for name, value in rows:
        lines += row(name, value)
    found = findings(flight)
    lines += ["", "What stands out"]
    lines += [text for event in found for text in _lines(event)] if found else ["  nothing"]
    lines += ["", "What happened"]
    lines += [text for event in flight.events for text in _lines(event)]
    return "\n".join(lines)


def spoken(event: Event) -> str:
    """Return the line of an event, with who says it."""
    return event.text if event.source == "review" else f"{event.source}: {event.text}"


def _lines(event: Event) -> list[str]:
    sign = "!" if is_grave(event) else " "
    return textwrap.wrap(
        spoken(event),
        _WIDTH,
        initial_indent=f"{sign} {event.time_s:8.1f} s  ",
        subsequent_indent=" " * _INDENT,
    )
