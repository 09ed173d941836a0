"""A Rerun recording of ours read back into a ``Flight``.

Only the chunk reader of rerun-sdk is used: no server, no pandas. A recording that was cut off is
read as far as it goes.
"""

import re
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from rerun.chunk import RrdReader

from companion.arrays import FloatArray, IntArray
from companion.errors import UsageError
from companion.session import colors, curves
from companion.session.colors import Color
from companion.session.flight import NOWHERE, City, CurveData, Flight, Track
from companion.session.records import Event, Source
from companion.session.rerun_log import FOLDED
from companion.session.summary import Summary
from companion.vehicle import Severity

_SEVERITIES = {
    "CRITICAL": Severity.CRITICAL,
    "ERROR": Severity.ERROR,
    "WARN": Severity.WARNING,
    "INFO": Severity.INFO,
    "DEBUG": Severity.DEBUG,
}
_TITLES = {curve.path: curve.title for curve in curves.CURVES} | {
    curves.OBSERVATION_PATH: curves.OBSERVATION_TITLE,
    curves.INTERVENED_PATH: "Shield interventions",
}
_TIMELINE = "session"


@dataclass
class _Entity:
    """The columns of one entity, chunks put together."""

    static: dict[str, Any] = field(default_factory=dict)
    time_s: list[FloatArray] = field(default_factory=list)
    columns: dict[str, list[Any]] = field(default_factory=dict)

    def times(self) -> FloatArray:
        return np.concatenate(self.time_s) if self.time_s else np.empty(0)

    def rows(self, name: str) -> list[Any]:
        """Return the values of a column, row by row, as plain lists."""
        return [row for part in self.columns.get(name, ()) for row in part.to_pylist()]

    def numbers(self, name: str) -> tuple[FloatArray, IntArray]:
        """Return the numbers of a column, row after row, and how many values each row has."""
        flat, counts = [np.empty(0)], [np.empty(0, dtype=np.int64)]
        for part in self.columns.get(name, ()):
            counts.append(part.value_lengths().fill_null(0).to_numpy().astype(np.int64))
            values = part.flatten()
            if hasattr(values, "flatten"):  # vectors
                values = values.flatten()
            flat.append(values.to_numpy(zero_copy_only=False).astype(np.float64))
        return np.concatenate(flat), np.concatenate(counts)

    def one(self, name: str) -> Any | None:
        """Return the only value of a static column."""
        column = self.static.get(name)
        values = None if column is None else column.to_pylist()
        return values[0] if values else None


def read_recording(path: Path) -> Flight:
    """Read a recording.

    Raises:
        UsageError: If it is no Rerun recording, or none of a flight of ours.
    """
    entities = _entities(path)
    if not any(name.startswith("/world") for name in entities):
        raise UsageError(f"{path} is a Rerun recording, but not of a flight of this program")
    flight = Flight(
        path=path, title=_word(entities, "/__properties", "RecordingInfo:name"), result=""
    )
    flight.recording = path
    _read_properties(entities, flight)
    for name, entity in entities.items():
        if name.startswith("/plots/") and entity.columns:
            curve = _curve(name[1:], entity)
            flight.curves[curve.path] = curve
        elif name.startswith("/state/"):
            flight.bands[name.removeprefix("/state/").replace("_", " ")] = _states(entity)
        elif name.startswith("/log/"):
            flight.events += _events(name, entity)
    flight.events.sort(key=lambda event: event.time_s)
    flight.vehicle = _track(entities, "vehicle")
    flight.target = _track(entities, "target")
    flight.city = _city(entities)
    flight.duration_s = max(
        [float(curve.time_s[-1]) for curve in flight.curves.values() if len(curve.time_s)]
        + [float(track.time_s[-1]) for track in (flight.vehicle,) if len(track.time_s)]
        + [0.0]
    )
    return flight


def _entities(path: Path) -> dict[str, _Entity]:
    entities: dict[str, _Entity] = {}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of a missing footer: the file was cut off
            for chunk in _chunks(path):
                batch = chunk.to_record_batch()
                entity = entities.setdefault(str(chunk.entity_path), _Entity())
                _add(entity, batch, static=chunk.is_static)
    except (OSError, RuntimeError, ValueError) as error:
        if not entities:
            reason = str(error).strip().splitlines()[0]
            raise UsageError(f"{path} is not a Rerun recording: {reason}") from error
    if not entities:
        raise UsageError(f"{path} is empty, or not a Rerun recording")
    return entities


def _chunks(path: Path) -> Iterator[Any]:
    yield from RrdReader(str(path)).stream()


def _add(entity: _Entity, batch: Any, *, static: bool) -> None:
    names = [name for name in batch.schema.names if "RowId" not in name]
    if static:
        entity.static.update({name: batch.column(name) for name in names})
        return
    if _TIMELINE not in names:
        return
    since_ns = batch.column(_TIMELINE).cast("int64").to_numpy()
    entity.time_s.append(since_ns * 1e-9)
    for name in names:
        if name not in (_TIMELINE, "utc", "log_time", "log_tick"):
            entity.columns.setdefault(name, []).append(batch.column(name))


def _word(entities: dict[str, _Entity], name: str, column: str) -> str:
    entity = entities.get(name)
    value = None if entity is None else entity.one(column)
    return "" if not value else str(value[0])


def _read_properties(entities: dict[str, _Entity], flight: Flight) -> None:
    """Read result and settings; those of older versions are words of the summary page only."""
    page = _word(entities, "/summary", "TextDocument:text")
    flight.result = page.partition("\n")[0].lstrip("# ") or "unknown"
    for cells in re.findall(r"^\|(.+)\|$", page, re.MULTILINE):
        cell = [text.strip() for text in cells.split("|")]
        flight.facts += [
            (name, value)
            for name, value in zip(cell[::2], cell[1::2], strict=False)
            if name.strip("-")
        ]
    summary = _word(entities, "/__properties/summary", "json")
    if summary:
        try:
            flight.summary = msgspec.json.decode(summary, type=Summary)
        except msgspec.DecodeError:
            flight.summary = None
    start = entities.get("/__properties")
    began = None if start is None else start.one("RecordingInfo:start_time")
    if began:
        flight.start_utc_us = (
            int(np.datetime64(began[0], "us").astype(np.int64))
            if not isinstance(began[0], int)
            else began[0] // 1000
        )


def _curve(path: str, entity: _Entity) -> CurveData:
    time_s = entity.times()
    numbers, counts = entity.numbers("Scalars:scalars")
    width = int(counts.max(initial=1))
    values = np.full((len(counts), width), np.nan)
    values[np.arange(width) < counts[:, np.newaxis]] = numbers
    order = np.argsort(time_s, kind="stable")
    kind = "SeriesPoints" if "SeriesPoints:names" in entity.static else "SeriesLines"
    names = entity.one(f"{kind}:names") or [path.rpartition("/")[2]]
    packed = entity.one(f"{kind}:colors") or []
    shades = [_unpacked(number) for number in packed]
    shades += [colors.cycle(index) for index in range(len(shades), width)]
    names = [*names, *(f"{index}" for index in range(len(names), width))]
    return CurveData(
        path,
        _TITLES.get(path, path.removeprefix("plots/")),
        tuple(names[:width]),
        tuple(shades[:width]),
        time_s[order],
        values[order],
    )


def _unpacked(number: int) -> Color:
    return number >> 24 & 0xFF, number >> 16 & 0xFF, number >> 8 & 0xFF


def _states(entity: _Entity) -> list[tuple[float, str]]:
    rows = entity.rows("StateChange:state")
    pairs = [
        (float(time_s), row[0]) for time_s, row in zip(entity.times(), rows, strict=True) if row
    ]
    return sorted(pairs, key=lambda pair: pair[0])


def _events(name: str, entity: _Entity) -> list[Event]:
    source: Source = "autopilot" if name.endswith("autopilot") else "companion"
    if name.endswith("review"):
        source = "review"
    levels = entity.rows("TextLog:level")
    texts = entity.rows("TextLog:text")
    events: list[Event] = []
    for time_s, level, row in zip(entity.times(), levels, texts, strict=True):
        text = (row or [""])[0]
        if text.startswith(FOLDED) and events:
            whole = f"{events[-1].text} {text.strip()}"
            events[-1] = msgspec.structs.replace(events[-1], text=whole)
            continue
        severity = _SEVERITIES.get((level or ["INFO"])[0], Severity.INFO)
        events.append(Event(float(time_s), severity, source, text))
    return events


def _track(entities: dict[str, _Entity], who: str) -> Track:
    entity = entities.get(f"/world/{who}")
    if entity is None or not entity.columns:
        return NOWHERE
    numbers, counts = entity.numbers("Transform3D:translation")
    time_s = entity.times()[counts > 0]
    if not len(time_s):
        return NOWHERE
    order = np.argsort(time_s, kind="stable")
    position_m = numbers.reshape(-1, 3)[order]
    return Track(time_s[order], position_m, _shades(entities, who, time_s[order]))


def _shades(entities: dict[str, _Entity], who: str, time_s: FloatArray) -> tuple[Color, ...]:
    """Return the colour of the path at each time; the pieces of the plan have them."""
    entity = entities.get(f"/plan/path/{who}")
    if entity is None or not entity.columns:
        return ()
    pieces = sorted(
        (float(at_s), _unpacked(row[0]))
        for at_s, row in zip(entity.times(), entity.rows("LineStrips2D:colors"), strict=True)
        if row
    )
    if not pieces:
        return ()
    piece = np.searchsorted([at_s for at_s, _ in pieces], time_s).clip(0, len(pieces) - 1)
    return tuple(pieces[index][1] for index in piece)


def _city(entities: dict[str, _Entity]) -> City | None:
    ground = entities.get("/world/map/ground")
    fence = entities.get("/world/map/geofence")
    corners = None if ground is None else ground.one("Mesh3D:vertex_positions")
    if not corners:
        return None
    east_m, north_m = np.array(corners)[:, :2].max(axis=0)
    strips = None if fence is None else fence.one("LineStrips3D:strips")
    top_m = max((point[2] for strip in strips or () for point in strip), default=0.0)
    plan = entities.get("/plan/map/obstacles")
    rings = (None if plan is None else plan.one("LineStrips2D:strips")) or []
    labels = (None if plan is None else plan.one("LineStrips2D:labels")) or []
    heights = [float(label.split()[0]) for label in labels]
    return City(
        _word(entities, "/__properties/map", "name"),
        (float(east_m), float(north_m), float(top_m)),
        tuple(np.array(ring)[:-1] * [1.0, -1.0] for ring in rings),
        tuple(heights),
    )
