"""The report of a session in words: what ``review`` prints and the viewer shows."""

from collections.abc import Sequence

from companion.session.records import SessionStart
from companion.session.summary import Summary

LEGEND = (
    "Path: **blue** the policy flew, **orange** the shield changed it, **red** inside the margin, "
    "**grey** the policy did not fly; in the plan, from **red** to **blue**: clearance. "
    "Arrows: **yellow** proposed, **green** sent, **blue** measured. "
    "**Violet**: rays that met a wall, and the way the actor was shown."
)
"""What the colours of the scene mean, Markdown."""
_MARKDOWN_COLUMNS = 2  # of names and values: that is what a laptop shows
_PANEL = (
    *("Duration", "Distance flown", "Final distance to target", "Smallest clearance"),
    *("Highest speed", "Shield interventions"),
    *("Battery", "Latency, p99", "Packets lost", "Actor", "Map", "Vehicle"),
)
"""Rows of the panel, in order; the others are in ``review --text`` and in the plots."""


def facts(summary: Summary) -> list[tuple[str, str]]:
    """Return what was measured as rows of name and value; what is unknown is left out."""
    rows = [
        ("Duration", _text("{:.1f} s", summary.duration_s)),
        ("Distance flown", _text("{:.1f} m", summary.distance_flown_m)),
        ("Final distance to target", _text("{:.1f} m", summary.final_distance_m)),
        ("Smallest clearance", _text("{:.2f} m", summary.min_clearance_m)),
        ("Highest speed", _text("{:.2f} m/s", summary.max_speed_mps)),
        ("Speed cap", _text("{:.2f} m/s", summary.v_max_mps)),
        ("Shield interventions", _interventions(summary)),
        ("Setpoints slowed", f"{summary.setpoints_slowed}"),
        ("Velocity lag", _text("{:.2f} s", summary.velocity_lag_s)),
        ("Setpoints sent", f"{summary.setpoints_sent}"),
        ("Setpoint rate", _text("{:.2f} Hz", summary.setpoint_rate_hz)),
        ("Jitter, p99", _text("{:.2f} ms", summary.jitter_p99_ms)),
        ("Latency, p50", _text("{:.2f} ms", summary.latency_p50_ms)),
        ("Latency, p99", _text("{:.2f} ms", summary.latency_p99_ms)),
        ("Late ticks", f"{summary.late_ticks}"),
        ("Packets lost", _text("{:.2f} %", summary.link_loss_percent)),
        ("Pilot take-overs", f"{summary.takeovers}"),
    ]
    return [(name, value) for name, value in rows if value]


def _interventions(summary: Summary) -> str:
    reasons = ", ".join(f"{reason} {count}" for reason, count in summary.shield_reasons.items())
    return f"{summary.shield_interventions}" + (f": {reasons}" if reasons else "")


def result_line(summary: Summary) -> str:
    """Return in a line how the run ended."""
    outcome = summary.outcome.replace("_", " ")
    return f"{outcome} (exit code {summary.exit_code}): {summary.reason}"


def markdown(start: SessionStart, summary: Summary | None) -> str:
    """Return the summary panel of the viewer, as long as nobody has reviewed the session."""
    vehicle = start.vehicle
    result = "in flight, or cut off: no result yet"
    rows: list[tuple[str, str]] = []
    if summary is not None:
        result = f"{summary.outcome.replace('_', ' ')}: {summary.reason}"
        rows = facts(summary)
    rows += [
        ("Actor", start.actor.name),
        ("Map", start.map.name),
        ("Vehicle", f"{vehicle.system_id}: {vehicle.autopilot} {vehicle.version}"),
    ]
    return "\n\n".join((f"#### {result}", table(rows), LEGEND)) + "\n"


def table(rows: Sequence[tuple[str, str]]) -> str:
    """Return what of ``rows`` the panel has room for, as Markdown."""
    known = {name.lower(): (name, value) for name, value in rows}
    shown = [known[name.lower()] for name in _PANEL if name.lower() in known]
    shown += [("", "")] * (-len(shown) % _MARKDOWN_COLUMNS)
    height = len(shown) // _MARKDOWN_COLUMNS
    lines = [[cell for row in shown[line::height] for cell in row] for line in range(height)]
    lines.insert(1, ["---", "---"] * _MARKDOWN_COLUMNS)  # the first row is the table's head
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def is_usual(text: str) -> bool:
    """Return whether the companion says this with emphasis where nothing is wrong."""
    return text.startswith(("blind travel ", "done: ")) or (
        text.startswith("handing over") and "from the target" in text
    )


def _text(form: str, value: float | None) -> str:
    return "" if value is None else form.format(value)
