"""Two flights in the viewer, in a picture, and on a page."""

import html
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from companion.errors import CompanionError
from companion.review import show
from companion.review.compare import FIRST, SECOND, Pair
from companion.review.findings import findings
from companion.review.page import header, picture_of, stands_out, write_html
from companion.review.plan_svg import plan_of
from companion.review.svg import Span, bands, plot
from companion.session import viewer
from companion.session.flight import City, Flight

_STATES = ("companion", "flight mode", "mode")


def recorded(both: Pair, folder: Path) -> Flight:
    """Return both as something the viewer opens: a recording written into ``folder``.

    Raises:
        UsageError: If Rerun is not installed.
        CompanionError: If it cannot be written.
    """
    viewer.viewer_binary()
    from companion.session.pair_recording import write_pair_recording

    recording = folder / "compare.rrd"
    try:
        write_pair_recording(
            recording,
            city=_city(both),
            names=both.names,
            shades=(FIRST, SECOND),
            tracks=both.tracks(),
            curves=both.curves(),
            bands=_states(both),
            page=_page(both),
            events=[findings(flight) for flight in both.flights],
            starts_s=both.starts_s(),
        )
    except (OSError, RuntimeError) as error:
        raise CompanionError(f"cannot write {recording}: {error}") from error
    return Flight(path=recording, title="compare", result="", recording=recording)


def write_pair_page(both: Pair, folder: Path, *, at_s: float | None) -> Path:
    """Write ``index.html`` with both flights into ``folder`` and return its path.

    Raises:
        UsageError: If the folder cannot be written to.
    """
    with tempfile.TemporaryDirectory(prefix="companion-compare-") as scratch:
        try:
            picture = picture_of(recorded(both, Path(scratch)), at_s)
        except CompanionError as error:
            picture = f"<p class=note>No picture: {html.escape(str(error))}</p>"
    curves = both.curves()
    begin_s = min((float(curve.time_s[0]) for curve in curves), default=0.0)
    end_s = max((float(curve.time_s[-1]) for curve in curves), default=1.0)
    span = Span(begin_s, max(begin_s + 1.0, end_s))
    rows = "".join(
        f'<tr class="{"" if first == second else "differs"}"><td>{html.escape(name)}</td>'
        f"<td>{html.escape(first)}</td><td>{html.escape(second)}</td></tr>"
        for name, first, second in both.rows()
    )
    names = "".join(f"<th>{html.escape(name)}</th>" for name in both.names)
    lines = "".join(plot(curve, span) for curve in curves)
    states = bands({name: list(changes) for name, changes in _states(both)}, span)
    paths = plan_of(_city(both), list(zip(both.names, both.tracks(), (FIRST, SECOND), strict=True)))
    body = [
        header("Two flights compared", " beside ".join(both.names), "", "good"),
        f"<section><table class=figures><tr><th></th>{names}</tr>{rows}</table></section>",
        *(
            stands_out(findings(flight), f"What stands out in {name}")
            for name, flight in zip(both.names, both.flights, strict=True)
        ),
        f"<section class=scene><figure>{paths}</figure>{picture}</section>",
        f"<section><h2>From moment to moment</h2>{states}{lines}</section>",
    ]
    return write_html(folder, "Two flights compared", "".join(body))


def open_pair(both: Pair) -> str:
    """Open both in the viewer and return what was done.

    Raises:
        UsageError: If Rerun is not installed.
    """
    folder = Path(tempfile.mkdtemp(prefix="companion-compare-"))
    return show.open_viewer(recorded(both, folder))


def _city(both: Pair) -> City:
    """Return what stands around: the first map that is known, large enough for both paths."""
    cities = [flight.city for flight in both.flights if flight.city is not None]
    with_obstacles = [city for city in cities if city.heights_m]
    if with_obstacles:
        return with_obstacles[0]
    places = [track.position_enu_m for track in both.tracks() if len(track.time_s)]
    high = np.vstack(places or [np.full((1, 3), 40.0)]).max(axis=0)
    sides = np.array([city.size_m for city in cities] + [(40.0, 40.0, 20.0)]).max(axis=0)
    east_m, north_m, up_m = (float(side) for side in np.maximum(high, sides))
    return City(cities[0].name if cities else "", (east_m, north_m, up_m))


def _states(both: Pair) -> list[tuple[str, Sequence[tuple[float, str]]]]:
    rows: list[tuple[str, Sequence[tuple[float, str]]]] = []
    for name in _STATES:
        for letter, flight, start_s in zip("ab", both.flights, both.starts_s(), strict=True):
            changes = flight.bands.get(name)
            if changes:
                shifted = [(time_s - start_s, word) for time_s, word in changes]
                rows.append((f"{name.replace('flight ', '')} {letter}", shifted))
    return rows


def _page(both: Pair) -> str:
    rows = "\n".join(
        f"| {name} | {first} | {second} |" for name, first, second in both.rows() if first != second
    )
    return (
        f"### {both.names[0]} (blue) beside {both.names[1]} (yellow)\n\n"
        f"| | {both.names[0]} | {both.names[1]} |\n|---|---|---|\n{rows}\n"
    )
