"""Which test cases the figures show, by a rule that is written beside them."""

import numpy as np
from shapely import LineString, Point, Polygon

from companion.world.maps import Map
from training.flights import Flight, Flights
from training.report_data import FlightRecord, Scene

_CROSSED_M = 10.0
_APART_M = 8.0
_CHASES = 200
_STEPS = 20


def across(flights: Flights, city: Map, obstacle: str, *, title: str, over: bool) -> Scene:
    """Return the first completed case whose straight line crosses an obstacle, seen from above.

    Args:
        flights: All test cases of the map.
        city: The map.
        obstacle: Name of the obstacle.
        title: Of the panel.
        over: Whether the flight itself must pass over the roof, or beside it.
    """
    outline = Polygon(city.footprints_m[city.obstacle_names.index(obstacle)])
    kind = [flight for flight in flights if _crosses(flight, outline)]
    completed = [flight for flight in kind if flight.outcome == "reached"]
    shown = [
        flight
        for flight in completed
        if (LineString(flight.position_enu_m[:, :2]).intersection(outline).length > 0.0) is over
    ]
    way = "over" if over else "around"
    choice = (
        f"{len(kind)} of {len(flights.last)} test cases have a straight line that crosses\n"
        f"{obstacle} seen from above, {len(completed)} of them were completed,\n"
        f"{len(shown)} of those {way} it; the first of these is shown"
    )
    return _scene(title, city, choice, shown[0] if shown else None)


def chase(flights: Flights, city: Map, *, title: str) -> Scene:
    """Return the completed chase in which the target came farthest within so many steps."""
    cases = [flights.case(number) for number in range(min(_CHASES, len(flights.last)))]
    completed = [flight for flight in cases if flight.outcome == "reached"]
    short = [flight for flight in completed if len(flight.position_enu_m) <= _STEPS + 1]
    choice = (
        f"of the first {len(cases)} test cases {len(completed)} were completed; shown is\n"
        f"the one of at most {_STEPS} steps in which the target went farthest"
    )
    return _scene(title, city, choice, max(short, key=_target_way_m, default=None))


def _scene(title: str, city: Map, choice: str, flight: Flight | None) -> Scene:
    shown = None if flight is None else FlightRecord.of(flight)
    return Scene(title=title, map=city.name, choice=choice, flight=shown)


def _crosses(flight: Flight, outline: Polygon) -> bool:
    start, target = flight.position_enu_m[0, :2], flight.target_enu_m[0, :2]
    if any(outline.distance(Point(end)) < _APART_M for end in (start, target)):
        return False
    crossed_m: float = LineString([start, target]).intersection(outline).length
    return crossed_m > _CROSSED_M


def _target_way_m(flight: Flight) -> float:
    return float(np.linalg.norm(np.diff(flight.target_enu_m, axis=0), axis=1).sum())
