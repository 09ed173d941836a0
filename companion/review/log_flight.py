"""A telemetry log as a ``Flight``, and as a recording for the viewer."""

from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path

import msgspec
import numpy as np

from companion.arrays import FloatArray
from companion.errors import MapError
from companion.review.log_story import LogStory
from companion.review.recordings import found_lines
from companion.session.colors import Color
from companion.session.flight import NOWHERE, City, CurveData, Flight, Track
from companion.session.log_curves import LOG_CURVES
from companion.session.motion import painter
from companion.session.records import (
    ActorRecord,
    MapRecord,
    SessionStart,
    Tick,
    VehicleRecord,
    map_record,
)
from companion.vehicle import Severity
from companion.world.frames import enu_to_geodetic, geodetic_to_enu
from companion.world.maps import Map

_LEAST_SIDE_M = 40.0
_RIM = 0.15


def log_start(story: LogStory, city: Map | None) -> tuple[SessionStart, list[Tick]]:
    """Return what the scene is made of, and the ticks in it.

    Args:
        story: The log.
        city: The map it is laid over; a box of air round the path, if not given.

    Raises:
        MapError: If the log cannot be placed on the map.
    """
    if city is None:
        record, corner = _box(story)
    else:
        record, corner = map_record(city), -_offset(story, city)
    ticks = [_moved(tick, corner) for tick in story.ticks]
    if city is not None and len(city.obstacles):
        ticks = _with_clearance(ticks, city)
    speeds = [tick.velocity_enu_mps for tick in ticks if tick.velocity_enu_mps is not None]
    fastest = float(np.linalg.norm(np.array(speeds), axis=-1).max()) if speeds else 1.0
    start = SessionStart(
        session_id=f"{story.path.stem}-{story.start_utc_us}",
        start_utc_us=story.start_utc_us,
        map=record,
        actor=ActorRecord(""),
        vehicle=VehicleRecord(story.senders.vehicle, story.senders.firmware, story.version),
        config={},
        v_max_mps=max(1.0, fastest),
        margin_m=0.0,
        arrival_radius_m=0.02 * max(record.size_m[:2]),
    )
    return start, ticks


def log_flight(story: LogStory, city: Map | None = None) -> Flight:
    """Return the log as it is reviewed.

    Raises:
        MapError: If the log cannot be placed on the map.
    """
    start, ticks = log_start(story, city)
    paint = painter(start)
    placed = [tick for tick in ticks if tick.position_enu_m is not None]
    others = [tick for tick in ticks if tick.target_enu_m is not None]
    curves = {}
    for curve in LOG_CURVES:
        time_s, values = curve.rows(ticks, start)
        names, shades = zip(*((line.name, line.color) for line in curve.lines), strict=True)
        if len(time_s):
            curves[curve.path] = CurveData(curve.path, curve.title, names, shades, time_s, values)
    east_m, north_m, up_m = start.map.size_m
    footprints_m = tuple(np.array(ring) for ring in start.map.footprints_m)
    settings = [("Vehicle", story.vehicle_name), ("Began", _date(story.start_utc_us))]
    return Flight(
        path=story.path,
        title=story.path.name,
        result=headline(story),
        start_utc_us=story.start_utc_us,
        duration_s=story.duration_s,
        facts=list(story.story.facts),
        settings=settings if city is None else [*settings, ("Map", city.name)],
        events=story.events,
        bands=story.story.bands,
        curves=curves,
        vehicle=_track([(tick, tick.position_enu_m) for tick in placed], paint),
        target=_track([(tick, tick.target_enu_m) for tick in others], None),
        city=City(
            start.map.name, (east_m, north_m, up_m), footprints_m, tuple(start.map.heights_m)
        ),
        write_recording=lambda recording: _write(story, start, ticks, recording),
    )


def _write(story: LogStory, start: SessionStart, ticks: Sequence[Tick], recording: Path) -> None:
    """Write the log as a recording."""
    from companion.session.log_recording import write_log_recording

    write_log_recording(
        recording,
        start,
        ticks=ticks,
        events=story.events,
        bands=story.story.bands,
        page=_page(story),
    )


def _box(story: LogStory) -> tuple[MapRecord, FloatArray]:
    """Return a box of air that holds the path, and where its corner lies in the local frame."""
    placed = [tick.position_enu_m for tick in story.ticks if tick.position_enu_m is not None]
    places = np.array(placed or [[0.0, 0.0, 0.0]])
    low, high = places.min(axis=0), places.max(axis=0)
    side_m = max(_LEAST_SIDE_M, (1.0 + 2.0 * _RIM) * float((high - low)[:2].max()))
    corner = np.array([*(0.5 * (low + high)[:2] - 0.5 * side_m), 0.0])
    top_m = max(0.3 * side_m, 1.1 * float(high[2]))
    place = None
    if story.origin is not None:
        point = enu_to_geodetic(story.origin, corner)
        place = [point.latitude_deg, point.longitude_deg, point.altitude_m]
    return MapRecord(story.path.name, [side_m, side_m, top_m], origin=place), corner


def _offset(story: LogStory, city: Map) -> FloatArray:
    """Return where the local frame is zero on the map; heights count from the take-off."""
    if city.origin is not None:
        if story.origin is None:
            raise MapError(
                f"the log does not tell where on earth it was, and {city.name} lies there"
            )
        east_m, north_m, _ = geodetic_to_enu(city.origin, story.origin)
        offset_m = np.array((east_m, north_m, 0.0))
    elif city.launch_enu_m is not None:
        offset_m = city.launch_enu_m
    else:
        raise MapError(f"{city.name} has neither an origin on earth nor a launch point")
    starts = [tick.position_enu_m for tick in story.ticks if tick.position_enu_m is not None]
    places_m = np.array(starts).reshape(-1, 3) + offset_m
    places_m[:, 2] = places_m[:, 2].clip(0.0, city.size_m[2])
    if len(starts) and not city.contains(places_m).any():
        raise MapError(f"the flight lies outside of {city.name} altogether")
    return offset_m


def _with_clearance(ticks: Sequence[Tick], city: Map) -> list[Tick]:
    places = [tick.position_enu_m for tick in ticks if tick.position_enu_m is not None]
    if not places:
        return list(ticks)
    clearances_m = iter(city.obstacles.signed_distance_m(np.array(places)).tolist())
    return [
        tick
        if tick.position_enu_m is None
        else msgspec.structs.replace(tick, clearance_m=next(clearances_m))
        for tick in ticks
    ]


def headline(story: LogStory) -> str:
    """Return in a line what became of the flight."""
    facts = dict(story.story.facts)
    grave = [event for event in story.events if event.severity <= Severity.WARNING]
    flown = facts.get("In the air")
    placed = any(tick.position_enu_m is not None for tick in story.ticks)
    never = "never took off" if placed else "no position in it: whether it flew is not told"
    words = never if flown is None else f"{flown} in the air"
    if story.story.in_air:
        words += ", not landed by the end of the log"
    if not grave:
        return f"{words}; nothing stands out"
    return f"{words}; {len(grave)} warning{'s' if len(grave) > 1 else ''}"


def _page(story: LogStory) -> str:
    """Return the summary for the viewer, Markdown."""
    first, *others = (f"| {name} | {value} |" for name, value in story.story.facts)
    rows = "\n".join((first, "|---|---|", *others))
    grave = [
        event
        for event in story.events
        if event.severity <= Severity.WARNING and event.source == "review"
    ]
    return (
        f"#### {headline(story)}\n\n{found_lines(grave)}\n\n{rows}\n\n"
        f"{story.vehicle_name}. {_date(story.start_utc_us)}. "
        "The colour of the path is that of the flight mode.\n"
    )


def _date(utc_us: int) -> str:
    return f"{datetime.fromtimestamp(utc_us / 1e6, UTC):%Y-%m-%d %H:%M:%S} UTC"


def _moved(tick: Tick, corner: FloatArray) -> Tick:
    def moved(place: list[float] | None) -> list[float] | None:
        return None if place is None else (np.array(place) - corner).tolist()

    return msgspec.structs.replace(
        tick, position_enu_m=moved(tick.position_enu_m), target_enu_m=moved(tick.target_enu_m)
    )


def _track(
    steps: Sequence[tuple[Tick, list[float] | None]], paint: Callable[[Tick], Color] | None
) -> Track:
    if not steps:
        return NOWHERE
    return Track(
        np.array([tick.time_s for tick, _ in steps]),
        np.array([place for _, place in steps]),
        () if paint is None else tuple(paint(tick) for tick, _ in steps),
    )
