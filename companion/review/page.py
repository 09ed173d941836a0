"""The review as a page: one HTML file that needs nothing else, to read, send and print."""

import base64
import html
import tempfile
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

import numpy as np

from companion.errors import CompanionError, UsageError
from companion.review import show
from companion.review.findings import findings, is_grave
from companion.review.plan_svg import plan
from companion.review.svg import Span, bands, clock_text, plot
from companion.review.words import spoken
from companion.session.curves import CHARTED, RATES_PATH, RATES_TITLE
from companion.session.flight import CurveData, Flight
from companion.session.records import Event

_TILES = (
    *("Duration", "In the air", "Distance flown", "Highest speed", "Smallest clearance"),
    *("Final distance to target", "Shield interventions", "Pilot take-overs", "Packets lost"),
    *("Longest setpoint gap", "Velocity error", "Battery"),
)
_MOST_TILES = 8
_ORDER = (
    *("plots/distance", "plots/clearance", "plots/altitude", "plots/speed"),
    *("plots/velocity/east", "plots/velocity/north", "plots/velocity/up", "plots/attitude"),
    *("plots/yaw", "plots/policy/action", "plots/health/loop", "plots/health/ages"),
    "plots/health/battery",
)
_MOST_MARKS = 40
_PATH_COLORS = "the clearance, from red at the margin to blue; grey: the policy did not fly"
_WINDOW = (1800, 1000)


def write_page(flight: Flight, folder: Path, *, at_s: float | None = None) -> Path:
    """Write ``index.html`` into ``folder`` and return its path.

    The picture is left out where the viewer cannot render one, and the page says why.

    Raises:
        UsageError: If the folder cannot be written to.
    """
    failed = flight.summary is not None and flight.summary.exit_code != 0
    found = findings(flight)
    state = "bad" if failed else "care" if found else "good"
    settings = " · ".join(
        f"<span>{html.escape(name)} <b>{html.escape(value)}</b></span>"
        for name, value in flight.settings
    )
    above = (
        f"<figure>{plan(flight)}<figcaption>From above, north up. The colour of the path is "
        f"{_PATH_COLORS if flight.summary is not None else 'that of the flight mode'}."
        "</figcaption></figure>"
    )
    body = [
        header(flight.title, flight.result, settings, state),
        stands_out(found, "What stands out"),
        _tiles(flight),
        f"<section class=scene>{above}{picture_of(flight, at_s)}</section>",
        _plots(flight),
        _events(flight),
        _table(flight),
    ]
    return write_html(folder, flight.title, "".join(body))


def picture_of(flight: Flight, at_s: float | None) -> str:
    """Return the scene as the viewer draws it, or a line on why there is no picture."""
    with tempfile.TemporaryDirectory(prefix="companion-page-") as scratch:
        png = Path(scratch) / "picture.png"
        try:
            show.render_png(flight, png, at_s=at_s, size=_WINDOW, views=("City", "Scene"))
        except CompanionError as error:
            return f"<p class=note>No picture of the viewer: {html.escape(str(error))}</p>"
        data = base64.b64encode(png.read_bytes()).decode()
    return (
        f'<figure><img alt="the scene" src="data:image/png;base64,{data}">'
        "<figcaption>companion review opens it in the viewer</figcaption></figure>"
    )


def header(title: str, result: str, settings: str, state: str) -> str:
    """Return the head of a page; ``settings`` is HTML, ``state`` good, care or bad."""
    return (
        f'<header class="{state}"><h1>{html.escape(title)}</h1>'
        f"<p class=result>{html.escape(result)}</p><p class=settings>{settings}</p></header>"
    )


def stands_out(found: Sequence[Event], title: str) -> str:
    """Return the list of what to read first."""
    lines = "".join(
        f"<li><time>{clock_text(round(event.time_s, 1))}</time> {html.escape(spoken(event))}</li>"
        for event in found
    )
    shown = f"<ul>{lines}</ul>" if lines else "<p>Nothing.</p>"
    return f"<section class=found><h2>{html.escape(title)}</h2>{shown}</section>"


def _tiles(flight: Flight) -> str:
    known = dict(flight.facts)
    shown = [(name, known[name]) for name in _TILES if name in known][:_MOST_TILES]
    cells = "".join(
        f"<div><b>{html.escape(value)}</b><span>{html.escape(name)}</span></div>"
        for name, value in shown
    )
    return f"<section class=tiles>{cells}</section>"


def _plots(flight: Flight) -> str:
    span = Span(0.0, max(1.0, flight.duration_s))
    marks = [event.time_s for event in findings(flight)][:_MOST_MARKS]
    parts = ["<section><h2>From moment to moment</h2>"]
    states = {name: changes for name, changes in flight.bands.items() if changes}
    if states:
        parts.append(bands(states, span))
    shield = flight.curves.get("plots/clearance/shield")
    for path in _ORDER:
        curve = flight.curves.get(path)
        if curve is not None and len(curve.time_s):
            parts.append(plot(curve, span, marks_s=marks))
        if path == "plots/clearance" and shield is not None:
            parts.append(_moments(shield, span))
    parts += _rates(flight, span)
    parts.append("<p class=note>Red lines mark what stands out.</p></section>")
    return "".join(parts)


def _moments(shield: CurveData, span: Span) -> str:
    """Return a thin row that shows when the shield stepped in."""
    changes: list[tuple[float, str]] = [(span.begin_s, "clear")]
    last_s = -1.0
    for time_s in shield.time_s.tolist():
        if time_s - last_s > 0.3:
            if last_s >= 0.0:
                changes.append((last_s, "clear"))
            changes.append((time_s, "shield"))
        last_s = time_s
    if last_s >= 0.0:
        changes.append((last_s, "clear"))
    return bands({"shield": changes}, span)


def _rates(flight: Flight, span: Span) -> list[str]:
    rates = [
        flight.curves[path]
        for path in (f"{RATES_PATH}/{name}" for name in CHARTED)
        if path in flight.curves
    ]
    if not rates:
        return []
    times = sorted({time_s for curve in rates for time_s in curve.time_s.tolist()})
    rows = {time_s: index for index, time_s in enumerate(times)}
    values = np.full((len(times), len(rates)), np.nan)
    for column, curve in enumerate(rates):
        for time_s, row in zip(curve.time_s.tolist(), curve.values, strict=True):
            values[rows[time_s], column] = row[0]
    names = tuple(curve.names[0] for curve in rates)
    shades = tuple(curve.colors[0] for curve in rates)
    together = CurveData(RATES_PATH, RATES_TITLE, names, shades, np.array(times), values)
    return [plot(together, span)]


def _events(flight: Flight) -> str:
    rows = "".join(
        f'<tr class="{_weight(event)}"><td>{clock_text(round(event.time_s, 1))}</td>'
        f"<td>{html.escape(spoken(event))}</td></tr>"
        for event in flight.events
    )
    return f"<section><h2>What happened</h2><table class=events>{rows}</table></section>"


def _weight(event: Event) -> str:
    return "grave" if is_grave(event) else ""


def _table(flight: Flight) -> str:
    rows = "".join(
        f"<tr><td>{html.escape(name)}</td><td>{html.escape(value)}</td></tr>"
        for name, value in (*flight.facts, *flight.settings)
    )
    return f"<section><h2>Figures</h2><table class=figures>{rows}</table></section>"


def write_html(folder: Path, title: str, body: str) -> Path:
    """Write ``index.html`` and return its path.

    Raises:
        UsageError: If the folder cannot be written to.
    """
    style = files("companion.review").joinpath("page.css").read_text(encoding="utf-8")
    page = (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<title>{html.escape(title)}</title><style>{style}</style></head>"
        f"<body><main>{body}</main></body></html>\n"
    )
    path = folder / "index.html"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        path.write_text(page, encoding="utf-8")
    except OSError as error:
        raise UsageError(f"cannot write {path}: {error.strerror}") from error
    return path
