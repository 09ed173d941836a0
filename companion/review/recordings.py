"""What the viewer opens of a flight: its recording, and over it what the review has found."""

from collections.abc import Sequence
from pathlib import Path

from companion.errors import CompanionError, UsageError
from companion.review.findings import findings
from companion.session import viewer
from companion.session.flight import Flight
from companion.session.records import Event
from companion.session.report import LEGEND, table

_MOST_FINDINGS = 6
_RECORDED = {"companion", "flight mode", "motors", "shield", "target"}
"""Bands that a session's recording holds."""


def make_recordings(flight: Flight, folder: Path) -> list[Path]:
    """Return what the viewer opens together; what there is not yet is written into ``folder``.

    Raises:
        UsageError: If there is nothing to record, or Rerun is not installed.
        CompanionError: If it cannot be written.
    """
    viewer.viewer_binary()
    try:
        if flight.recording is None:
            if flight.write_recording is None:
                raise UsageError(f"{flight.path} has neither recording nor frames: nothing to show")
            recording = folder / f"{flight.path.stem}.rrd"
            flight.write_recording(recording)
            return [recording]
        if "motors" not in flight.bands:  # two flights compared: their page is in the recording
            return [flight.recording]
        layer = folder / "review.rrd"
        _write_layer(flight, flight.recording, layer)
    except (OSError, RuntimeError) as error:
        raise CompanionError(f"cannot write into {folder}: {error}") from error
    return [flight.recording, layer]


def found_lines(found: Sequence[Event]) -> str:
    """Return what stands out as a list, Markdown: the first few."""
    lines = [f"- **{event.time_s:.1f} s** {event.text}" for event in found[:_MOST_FINDINGS]]
    if len(found) > _MOST_FINDINGS:
        lines.append(f"- and {len(found) - _MOST_FINDINGS} more: see the messages")
    return "\n".join(lines) or "Nothing stands out."


def _write_layer(flight: Flight, recording: Path, layer: Path) -> None:
    from companion.session.review_layer import write_review_layer

    found = findings(flight)
    told = [event for event in flight.events if event.source == "review"]
    new = [event for event in found if event.source == "review" and event not in told]
    page = (f"#### {flight.result}", found_lines(found), table([*flight.facts, *flight.settings]))
    write_review_layer(
        layer,
        recording,
        start_utc_us=flight.start_utc_us,
        page="\n\n".join((*page, LEGEND)) + "\n",
        events=sorted([*told, *new], key=lambda event: event.time_s),
        bands={
            name: changes
            for name, changes in flight.bands.items()
            if name not in _RECORDED and _changes_in_flight(changes, flight)
        },
    )


def _changes_in_flight(changes: Sequence[tuple[float, str]], flight: Flight) -> bool:
    """Return whether a band tells anything after the start: there is no room for the others."""
    armed_s = min((at_s for at_s, word in flight.bands["motors"] if word == "armed"), default=0.0)
    return any(time_s > armed_s for time_s, _ in changes)
