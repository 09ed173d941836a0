"""What a review has found, as a second recording: the viewer lays it over that of the session.

Both carry one recording id. Nothing is written into the session itself.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import rerun as rr
from rerun.chunk import RrdReader

from companion.session.bands import StateBand
from companion.session.records import Event
from companion.session.rerun_log import send_events
from companion.session.writer import StreamWriter


def write_review_layer(
    path: Path,
    recording: Path,
    *,
    start_utc_us: int,
    page: str,
    events: Sequence[Event],
    bands: Mapping[str, Sequence[tuple[float, str]]],
) -> None:
    """Write a layer over ``recording``.

    Args:
        path: The file; overwritten.
        recording: What it lies over.
        start_utc_us: Wall-clock time at ``time_s == 0``, microseconds since 1970.
        page: The summary, Markdown; it takes the place of that of the recording.
        events: Lines for the messages, in order.
        bands: Further states by name, each from its time on.

    Raises:
        OSError: If the file cannot be written.
        RuntimeError: If ``recording`` cannot be read.
    """
    below = RrdReader(str(recording)).recordings()[0]
    stream = rr.RecordingStream(below.application_id, recording_id=below.recording_id)
    stream.set_log_time_enabled(False)
    stream.set_sinks(rr.FileSink(path))
    writer = StreamWriter(stream, start_utc_us)
    send_events(writer, events)
    for name, changes in bands.items():
        StateBand(writer, f"state/{name.replace(' ', '_')}").send(changes)
    writer.static("summary", rr.TextDocument(page, media_type=rr.MediaType.MARKDOWN))
    stream.flush()
    stream.disconnect()
