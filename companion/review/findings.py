"""What stands out in a flight: the lines that a reviewer should read first."""

import itertools
import math
from collections.abc import Iterator

import numpy as np

from companion.arrays import BoolArray
from companion.session.flight import CurveData, Flight
from companion.session.records import Event
from companion.session.report import is_usual
from companion.vehicle import Severity

_SHORT_S = 0.5  # states this short are not worth a line of their own
_LATE_MS = 50.0  # a tick at 20 Hz
_FLYING = ("engaged", "holding")
_BAND_FINDINGS = {
    ("target", "coast"): "no news of the target: its last velocity was carried on",
    ("target", "hold"): "no news of the target: too old to chase",
    ("target", "lost"): "the target was LOST",
    ("shield", "inside the margin"): "the vehicle was INSIDE THE MARGIN",
    ("shield", "blocked"): "the shield found no safe way on",
}


def is_grave(event: Event) -> bool:
    """Return whether a line should not be missed."""
    return event.severity <= Severity.WARNING and not is_usual(event.text)


def findings(flight: Flight) -> list[Event]:
    """Return what stands out, in order; lines of one kind that follow each other are one."""
    grave = [event for event in flight.events if is_grave(event)]
    states = flight.bands.get("companion", [])
    flown_s = min((begin_s for begin_s, word in states if word in _FLYING), default=math.inf)
    began_s = flown_s if states else 0.0  # what a session measures on the ground is preparation
    measured = [*_of_bands(flight), *_of_curves(flight)]
    found = [*grave, *(line for line in measured if line.time_s >= began_s)]
    return _joined(sorted(found, key=lambda event: event.time_s))


def _of_bands(flight: Flight) -> Iterator[Event]:
    for (band, word), text in _BAND_FINDINGS.items():
        changes = [*flight.bands.get(band, ()), (flight.duration_s, "")]
        for (begin_s, state), (end_s, _) in itertools.pairwise(changes):
            if state == word and end_s - begin_s >= _SHORT_S:
                yield _line(begin_s, f"{text} ({end_s - begin_s:.1f} s)")


def _of_curves(flight: Flight) -> Iterator[Event]:
    clearance = flight.curves.get("plots/clearance")
    if clearance is not None:
        yield from _too_close(clearance)
    ages = flight.curves.get("plots/health/ages")
    if ages is not None:
        for name, limit_s in (("position", 1.0), ("heartbeat", 2.5)):
            yield from _too_old(ages, name, limit_s)
    loop = flight.curves.get("plots/health/loop")
    if loop is not None:
        yield from _too_late(loop, flight.bands.get("companion", []))


def _too_close(clearance: CurveData) -> Iterator[Event]:
    _, margin_m = clearance.line("margin")
    time_s, clearance_m = clearance.line(clearance.names[0])
    if not len(clearance_m) or not len(margin_m):
        return
    index = int(np.argmin(clearance_m))
    if clearance_m[index] < margin_m[0]:
        text = f"the clearance fell to {clearance_m[index]:.1f} m, the margin is {margin_m[0]:g} m"
        yield _line(float(time_s[index]), text)


def _too_old(ages: CurveData, name: str, limit_s: float) -> Iterator[Event]:
    time_s, age_s = ages.line(name)
    for begin, end in _runs(age_s > limit_s):
        text = f"the {name} was up to {age_s[begin:end].max():.1f} s old"
        yield _line(float(time_s[begin]), text)


def _too_late(loop: CurveData, states: list[tuple[float, str]]) -> Iterator[Event]:
    """Tell of turns that came late while setpoints flew the vehicle."""
    time_s, late_ms = loop.line("behind its deadline")
    began = np.searchsorted([begin_s for begin_s, _ in states], time_s, side="right") - 1
    flying = np.array([word in _FLYING for _, word in states] + [False])[began]
    late = (late_ms > _LATE_MS) & flying
    if late.any():
        worst_ms = late_ms[late].max()
        times = "once" if late.sum() == 1 else f"{late.sum()} times"
        text = f"the control loop was late {times}, by up to {worst_ms:.0f} ms"
        yield _line(float(time_s[int(np.argmax(late))]), text)


def _runs(flags: BoolArray) -> Iterator[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate(([0], flags.astype(int), [0]))))
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)


def _line(time_s: float, text: str) -> Event:
    return Event(time_s, Severity.WARNING, "review", text)


def _joined(events: list[Event]) -> list[Event]:
    """Join lines that repeat each other word for word but for their numbers."""
    joined: list[Event] = []
    for (_, key), group in itertools.groupby(events, lambda event: (event.source, _kind(event))):
        lines = list(group)
        if len(lines) == 1 or not key:
            joined += lines
            continue
        first, last = lines[0], lines[-1]
        until = f"{len(lines)} times until {last.time_s:.1f} s"
        joined.append(Event(first.time_s, first.severity, first.source, f"{first.text} ({until})"))
    return joined


def _kind(event: Event) -> str:
    return "".join(letter for letter in event.text if not letter.isdigit())
