"""How a session opens in the viewer: scene and plots above, summary, states and messages below."""

import rerun.blueprint as rrb

from companion.session import curves, log_curves
from companion.session.records import MapRecord, SessionStart
from companion.session.views import (
    ALWAYS,
    LAST_MINUTE,
    assemble,
    chase_view,
    city_view,
    earth_view,
    page,
    plan_view,
    plot,
    rates,
    series,
)

_MOST_NAMES = 8
"""A legend of more would hide its plot."""


def blueprint(start: SessionStart, *, live: bool) -> rrb.Blueprint:
    """Return the layout; a live view follows the vehicle and shows the last minute.

    It depends on what the session was started with, never on what happened in it: the viewer
    shows all sessions of this application in one layout.
    """
    window = LAST_MINUTE if live else ALWAYS
    flight = (curves.DISTANCE, curves.CLEARANCE, curves.ALTITUDE, curves.SPEED)
    plots = [
        page("Flight", flight, start, window),
        page("Velocity", (curves.EAST, curves.NORTH, curves.UP), start, window),
        page("Policy", (curves.ACTION, curves.RHO, curves.ANGLES), start, window),
        _observation(start, window),
        _health(start, window),
    ]
    scenes = [city_view(start.map), plan_view(start.map), chase_view(start.map)]
    if start.map.origin is not None:
        scenes.append(earth_view(start.map))
    return assemble(scenes, plots, window, active="Chase" if live else "City", live=live)


def log_blueprint(start: SessionStart) -> rrb.Blueprint:
    """Return the layout of a telemetry log: there is no policy, no shield and no map in it."""
    flight = [log_curves.ALTITUDE, log_curves.SPEED, log_curves.TILT]
    if start.map.footprints_m:
        flight.insert(1, log_curves.CLEARANCE)
    plots = [
        page("Flight", flight, start, ALWAYS),
        page("Velocity", log_curves.VELOCITY, start, ALWAYS),
        rrb.Vertical(
            *(plot(curve, start, ALWAYS) for curve in log_curves.HEALTH),
            rates(ALWAYS),
            name="Health",
        ),
    ]
    scenes = [city_view(start.map, "Scene"), plan_view(start.map), chase_view(start.map)]
    if start.map.origin is not None:
        scenes.append(earth_view(start.map))
    return assemble(scenes, plots, ALWAYS, active="Scene", live=False)


def map_blueprint(city: MapRecord) -> rrb.Blueprint:
    """Return the layout of a map alone."""
    return rrb.Blueprint(city_view(city), collapse_panels=True)


def _observation(start: SessionStart, window: rrb.TimeRange) -> rrb.Vertical:
    shown = (
        series(path, curves.observation_title(path), window, legend=len(columns) < _MOST_NAMES)
        for path, columns in curves.observation_groups(start.actor.columns).items()
    )
    return rrb.Vertical(*shown, name="Observation")


def _health(start: SessionStart, window: rrb.TimeRange) -> rrb.Vertical:
    shown = (plot(curve, start, window) for curve in (curves.LOOP, curves.AGES, curves.BATTERY))
    return rrb.Vertical(*shown, rates(window), name="Health")
