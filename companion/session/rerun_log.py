"""A session as entities of a Rerun stream.

    world/map/...       ground, geofence, obstacles, static; the frame is the map's, ENU with z up
    world/vehicle       its pose, and its shape as children; world/target likewise
    world/chase         the vehicle's place and course: the chase camera looks along it
    world/velocity/...  arrows: proposed, sent, measured
    world/seen/...      rays of the observation that met a wall, and the way the actor was shown
    world/pole          a pole at the target, with its name above the roofs
    world/path/...      where vehicle and target have been; the colour says who decided
    world/marks/...     places worth a label
    plan/...            the same from above, flat
    earth/...           the same by latitude and longitude, on maps that lie somewhere
    plots/...           the curves of ``companion.session.curves``
    state/...           the bands of ``companion.session.bands``
    log/...             messages of the autopilot and of the companion
    summary             a page of text

Records are sent as columns: a row at a time would cost ten times the bytes.
"""

import contextlib
import textwrap
from collections.abc import Sequence

import msgspec
import rerun as rr

from companion.session import scene
from companion.session.bands import Bands
from companion.session.earth_view import EarthView
from companion.session.moving import Moving
from companion.session.plan import Plan
from companion.session.plots import Plots
from companion.session.records import Event, Mark, SessionStart, Tick
from companion.session.report import is_usual, markdown
from companion.session.summary import Summary
from companion.session.writer import StreamWriter
from companion.vehicle import Severity

_FLUSH_S = 5.0
_FOLD = 54  # letters
FOLDED = "    "
"""What the second and further lines of a long text begin with."""
_LEVELS = {
    Severity.WARNING: rr.TextLogLevel.WARN,
    Severity.NOTICE: rr.TextLogLevel.INFO,
    Severity.INFO: rr.TextLogLevel.INFO,
    Severity.DEBUG: rr.TextLogLevel.DEBUG,
}


def send_events(writer: StreamWriter, events: Sequence[Event], root: str = "log") -> None:
    """Send lines of text, each source on its own below ``root``."""
    for source in sorted({event.source for event in events}):
        lines = [
            msgspec.structs.replace(event, text=text)
            for event in events
            if event.source == source
            for text in _folded(event.text)
        ]
        levels = [_level(line) for line in lines]
        columns = rr.TextLog.columns(text=[line.text for line in lines], level=levels)
        writer.columns(f"{root}/{source}", [_told_s(line.time_s) for line in lines], columns)


def _level(event: Event) -> rr.TextLogLevel:
    """Return the viewer's word for how grave a line is; an arrival is not."""
    if event.severity is Severity.WARNING and event.text.startswith("handing over"):
        return rr.TextLogLevel.INFO if is_usual(event.text) else rr.TextLogLevel.WARN
    return _LEVELS.get(event.severity, rr.TextLogLevel.ERROR)


def _folded(text: str) -> list[str]:
    """Fold what the messages view of a laptop would cut off."""
    return textwrap.wrap(text, _FOLD, subsequent_indent=FOLDED) or [""]


def _told_s(time_s: float) -> float:
    """Round to what the viewer's time column has room for."""
    return round(time_s, 1) if time_s < 100.0 else float(round(time_s))


class SessionLog:
    """Logs one session to one stream."""

    def __init__(self, stream: rr.RecordingStream, start: SessionStart) -> None:
        """Log everything that does not change."""
        self._stream = stream
        self._start = start
        self._writer = StreamWriter(stream, start.start_utc_us)
        self._marks: dict[str, Mark] = {}
        stream.send_recording_name(f"{start.map.name} {start.session_id}")
        stream.send_recording_start_time_nanos(start.start_utc_us * 1000)
        map_, actor, vehicle = start.map, start.actor, start.vehicle
        stream.send_property("map", rr.AnyValues(name=map_.name, hash=map_.content_hash))
        stream.send_property("actor", rr.AnyValues(name=actor.name, sha256=actor.sha256))
        stream.send_property(
            "vehicle", rr.AnyValues(autopilot=vehicle.autopilot, version=vehicle.version)
        )
        scene.draw_map(stream, start.map)
        writer = self._writer
        self._paths = Moving(writer, start), Plan(writer, start)
        self._parts = (
            *self._paths,
            EarthView(writer, start),
            Plots(writer, start),
            Bands(writer),
        )
        self._summarise(None)

    def send(self, ticks: Sequence[Tick], events: Sequence[Event]) -> None:
        """Send a batch, oldest first."""
        if ticks:
            for part in self._parts:
                part.send(ticks)
        send_events(self._writer, events)

    def mark(self, mark: Mark) -> None:
        """Put a label on the map."""
        self._marks[mark.label] = mark
        shapes = scene.marks(list(self._marks.values()), max(self._start.map.size_m[:2]))
        self._writer.static("world/marks", shapes)

    def end(self, summary: Summary) -> None:
        """Log how the session ended, for people and as columns of a table of sessions."""
        result = rr.AnyValues(
            outcome=summary.outcome,
            exit_code=summary.exit_code,
            duration_s=summary.duration_s,
            min_clearance_m=summary.min_clearance_m,
            shield_interventions=summary.shield_interventions,
        )
        self._stream.send_property("result", result)
        whole = msgspec.json.encode(summary).decode()
        self._stream.send_property("summary", rr.AnyValues(json=whole))
        self._summarise(summary)

    def close(self) -> None:
        """Finish the stream."""
        for part in self._paths:
            part.finish()
        with contextlib.suppress(RuntimeError):  # a viewer that reads no more must not hold us
            self._stream.flush(timeout_sec=_FLUSH_S)
        self._stream.disconnect()

    def _summarise(self, summary: Summary | None) -> None:
        text = markdown(self._start, summary)
        self._writer.static("summary", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN))
