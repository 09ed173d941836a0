"""A telemetry log as a recording: the same scene and plots as a session, in another layout."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import rerun as rr

from companion.session import scene
from companion.session.bands import StateBand
from companion.session.blueprint import log_blueprint
from companion.session.earth_view import EarthView
from companion.session.moving import Moving
from companion.session.plan import Plan
from companion.session.plots import Plots
from companion.session.records import Event, SessionStart, Tick
from companion.session.rerun_log import send_events
from companion.session.writer import StreamWriter

LOG_APPLICATION = "companion-log"
"""The viewer keeps one layout for each application."""


def write_log_recording(
    path: Path,
    start: SessionStart,
    *,
    ticks: Sequence[Tick],
    events: Sequence[Event],
    bands: Mapping[str, Sequence[tuple[float, str]]],
    page: str,
) -> None:
    """Write a recording of a flight that was read from a log.

    Args:
        path: The file; overwritten.
        start: What the ticks refer to; no actor.
        ticks: In order.
        events: In order.
        bands: States by name, each from its time on.
        page: The summary, Markdown.

    Raises:
        OSError: If the file cannot be written.
    """
    stream = rr.RecordingStream(LOG_APPLICATION, recording_id=start.session_id)
    stream.set_log_time_enabled(False)
    stream.set_sinks(rr.FileSink(path))
    stream.send_blueprint(log_blueprint(start))
    stream.send_recording_name(start.map.name)
    stream.send_recording_start_time_nanos(start.start_utc_us * 1000)
    stream.send_property("map", rr.AnyValues(name=start.map.name))
    writer = StreamWriter(stream, start.start_utc_us)
    scene.draw_map(stream, start.map)
    paths = Moving(writer, start), Plan(writer, start)
    for part in (*paths, EarthView(writer, start), Plots(writer, start)):
        part.send(ticks)
    for part in paths:
        part.finish()
    for name, changes in bands.items():
        StateBand(writer, f"state/{name.replace(' ', '_')}").send(changes)
    send_events(writer, events)
    writer.static("summary", rr.TextDocument(page, media_type=rr.MediaType.MARKDOWN))
    stream.flush()
    stream.disconnect()
