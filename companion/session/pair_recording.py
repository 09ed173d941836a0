"""Two flights in one recording: both paths in one scene, one line of each in every plot."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from companion.session import scene
from companion.session.bands import StateBand
from companion.session.colors import Color
from companion.session.flight import City, CurveData, Track
from companion.session.records import Event, MapRecord
from companion.session.rerun_log import send_events
from companion.session.views import ALWAYS, assemble, city_view, series
from companion.session.writer import StreamWriter

_APPLICATION = "companion-pair"
_PLOTS = 5


def write_pair_recording(
    path: Path,
    *,
    city: City,
    names: tuple[str, str],
    shades: tuple[Color, Color],
    tracks: tuple[Track, Track],
    curves: Sequence[CurveData],
    bands: Sequence[tuple[str, Sequence[tuple[float, str]]]],
    page: str,
    events: Sequence[Sequence[Event]],
    starts_s: tuple[float, float],
) -> None:
    """Write both flights; times count from where they are compared.

    Raises:
        OSError: If the file cannot be written.
    """
    record = MapRecord(
        city.name,
        list(city.size_m),
        [ring.tolist() for ring in city.footprints_m],
        list(city.heights_m),
        [f"obstacle {index + 1}" for index in range(len(city.heights_m))],
    )
    stream = rr.RecordingStream(_APPLICATION)
    stream.set_log_time_enabled(False)
    stream.set_sinks(rr.FileSink(path))
    stream.send_blueprint(_layout(record, curves))
    stream.send_recording_name(f"{names[0]} | {names[1]}")
    writer = StreamWriter(stream, 0)
    scene.draw_map(stream, record)
    for name, color, track in zip(("a", "b"), shades, tracks, strict=True):
        label = names[0] if name == "a" else names[1]
        _send_track(writer, f"world/{name}", track, color, label, max(city.size_m[:2]))
    for curve in curves:
        writer.static(
            curve.path,
            rr.SeriesLines(names=list(curve.names), colors=list(curve.colors), widths=[2.0, 2.0]),
        )
        for index, name in enumerate(curve.names):
            time_s, values = curve.line(name)
            own = f"{curve.path}/{'ab'[index]}"
            style = rr.SeriesLines(names=[name], colors=[curve.colors[index]], widths=[2.0])
            writer.static(own, style)
            writer.scalars(own, time_s, values)
    for name, changes in bands:
        StateBand(writer, f"state/{name.replace(' ', '_')}").send(changes)
    for name, lines, start_s in zip("ab", events, starts_s, strict=True):
        label = names["ab".index(name)]
        told = [
            Event(line.time_s - start_s, line.severity, "review", f"{label}: {line.text}")
            for line in lines
        ]
        send_events(writer, told, root=f"log/{name}")
    writer.static("summary", rr.TextDocument(page, media_type=rr.MediaType.MARKDOWN))
    stream.flush()
    stream.disconnect()


def _layout(city: MapRecord, curves: Sequence[CurveData]) -> rrb.Blueprint:
    views = [series(curve.path, curve.title, ALWAYS) for curve in curves]
    pages = [
        rrb.Vertical(*views[first : first + _PLOTS], name=name)
        for name, first in (("Flight", 0), ("More", _PLOTS))
        if views[first : first + _PLOTS]
    ]
    return assemble([city_view(city, "Scene")], pages, ALWAYS, active="Scene", live=False)


def _send_track(
    writer: StreamWriter, path: str, track: Track, color: Color, label: str, edge_m: float
) -> None:
    if not len(track.time_s):
        return
    line = rr.LineStrips3D([track.position_enu_m], colors=[color], radii=rr.Radius.ui_points(2.5))
    writer.static(f"{path}/path", line)
    dot = rr.Points3D.from_fields(
        colors=[color], radii=0.012 * edge_m, labels=[label], show_labels=True
    )
    writer.static(f"{path}/place", dot)
    columns = rr.Points3D.columns(positions=np.asarray(track.position_enu_m))
    writer.columns(f"{path}/place", track.time_s, columns)
