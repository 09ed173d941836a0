"""Two flights laid over each other: two actors on one mission, or a flight beside its replay."""

import textwrap
from dataclasses import dataclass

import numpy as np

from companion.arrays import FloatArray
from companion.review.findings import findings
from companion.review.words import spoken
from companion.session import colors
from companion.session.colors import Color
from companion.session.flight import CurveData, Flight, Track

FIRST: Color = colors.MEASURED
SECOND: Color = colors.PROPOSED
_COLUMN = 25
_NAME = 26
_LINES = {
    "plots/distance": "to target",
    "plots/clearance": "clearance",
    "plots/altitude": "vehicle",
    "plots/speed": "measured",
    "plots/velocity/east": "measured",
    "plots/velocity/north": "measured",
    "plots/velocity/up": "measured",
    "plots/health/loop": "latency",
    "plots/health/battery": "battery",
}
"""The line of each plot that is laid over that of the other flight."""
_SENT = ("plots/velocity/east", "plots/velocity/north", "plots/velocity/up")
_STEPS = 200


@dataclass(frozen=True)
class Pair:
    """Two flights; the times of each count from where its policy, or its log, begins."""

    first: Flight
    second: Flight
    names: tuple[str, str]

    @property
    def flights(self) -> tuple[Flight, Flight]:
        """Return both."""
        return self.first, self.second

    def rows(self) -> list[tuple[str, str, str]]:
        """Return name and both values of everything that is known of either."""
        tables = [
            {"Result": flight.result} | dict(flight.settings) | dict(flight.facts)
            for flight in self.flights
        ]
        names = dict.fromkeys([*tables[0], *tables[1]])
        rows = [(name, tables[0].get(name, "-"), tables[1].get(name, "-")) for name in names]
        return rows + self._differences()

    def curves(self) -> list[CurveData]:
        """Return one plot for each that both have, with a line of each flight."""
        found = []
        for path, line in _LINES.items():
            first, second = (flight.curves.get(path) for flight in self.flights)
            if first is None or second is None:
                continue
            parts = [
                _shifted(curve.line(line), start_s)
                for curve, start_s in zip((first, second), self.starts_s(), strict=True)
            ]
            if len(parts[0][0]) and len(parts[1][0]):
                found.append(_overlaid(path, first.title, parts, self.names))
        return found

    def starts_s(self) -> tuple[float, float]:
        """Return when the part that is compared begins in each flight."""
        first, second = (_engaged_s(flight) for flight in self.flights)
        if first is None or second is None:
            return 0.0, 0.0
        return first, second

    def tracks(self) -> tuple[Track, Track]:
        """Return both paths, their times shifted."""
        first, second = (
            Track(flight.vehicle.time_s - start_s, flight.vehicle.position_enu_m)
            for flight, start_s in zip(self.flights, self.starts_s(), strict=True)
        )
        return first, second

    def _differences(self) -> list[tuple[str, str, str]]:
        rows = []
        first, second = self.tracks()
        if len(first.time_s) and len(second.time_s):
            end_s = min(float(first.time_s[-1]), float(second.time_s[-1]))
            at_s = np.linspace(0.0, max(0.0, end_s), _STEPS)
            apart_m = np.linalg.norm(_at(first, at_s) - _at(second, at_s), axis=-1)
            rows.append(
                (
                    "Apart at the same moment",
                    f"{apart_m.mean():.1f} m on average",
                    f"{apart_m.max():.1f} m at most",
                )
            )
        errors = [_sent_apart(self.first, self.second, path, self.starts_s()) for path in _SENT]
        known = [error for error in errors if error is not None]
        if len(known) == len(_SENT):
            length = np.linalg.norm(np.array(known), axis=0)
            rows.append(
                (
                    "Velocities sent differ by",
                    f"{length.mean():.2f} m/s on average",
                    f"{length.max():.2f} m/s at most",
                )
            )
        return rows


def pair(first: Flight, second: Flight) -> Pair:
    """Return two flights to be laid over each other, named by what tells them apart."""
    actors = [dict(flight.settings).get("actor", "") for flight in (first, second)]
    if all(actors) and actors[0] != actors[1]:
        return Pair(first, second, (actors[0], actors[1]))
    if first.title != second.title:
        day = first.title.partition("T")[0] + "T"
        names = first.title, second.title
        if all(name.startswith(day) for name in names):  # sessions of one day
            names = first.title.removeprefix(day), second.title.removeprefix(day)
        return Pair(first, second, names)
    return Pair(first, second, (f"{first.title} (A)", f"{second.title} (B)"))


def words(both: Pair) -> str:
    """Return both flights as a table, to be read at 80 columns, and what stands out in each."""
    lines = [_columns(("", *both.names))]
    for name, first, second in both.rows():
        sign = " " if first == second else "*"
        lines.append(_columns((f"{sign} {name}", first, second)))
    for name, flight in zip(both.names, both.flights, strict=True):
        lines += ["", f"What stands out in {name}"]
        found = findings(flight)
        for event in found:
            lines += textwrap.wrap(
                spoken(event),
                80,
                initial_indent=f"! {event.time_s:8.1f} s  ",
                subsequent_indent=" " * 14,
            )
        if not found:
            lines.append("  nothing")
    return "\n".join(lines)


def _columns(cells: tuple[str, str, str]) -> str:
    wrapped = [
        textwrap.wrap(cell, width, subsequent_indent=indent) or [""]
        for cell, width, indent in zip(
            cells, (_NAME, _COLUMN, _COLUMN), ("    ", "", ""), strict=True
        )
    ]
    height = max(map(len, wrapped))
    full = [column + [""] * (height - len(column)) for column in wrapped]
    return "\n".join(
        f"{name:<{_NAME}}  {first:<{_COLUMN}}  {second}".rstrip()
        for name, first, second in zip(*full, strict=True)
    )


def _engaged_s(flight: Flight) -> float | None:
    """Return when setpoints began to fly the vehicle."""
    for name, words in (
        ("companion", ("engaged",)),
        ("mode", ("OFFBOARD", "GUIDED")),
        ("flight mode", ("OFFBOARD", "GUIDED")),
    ):
        for time_s, word in flight.bands.get(name, ()):
            if word in words:
                return time_s
    return None


def _shifted(line: tuple[FloatArray, FloatArray], start_s: float) -> tuple[FloatArray, FloatArray]:
    return line[0] - start_s, line[1]


def _overlaid(
    path: str,
    title: str,
    parts: list[tuple[FloatArray, FloatArray]],
    names: tuple[str, str],
) -> CurveData:
    time_s = np.concatenate([part[0] for part in parts])
    values = np.full((len(time_s), 2), np.nan)
    values[: len(parts[0][0]), 0] = parts[0][1]
    values[len(parts[0][0]) :, 1] = parts[1][1]
    order = np.argsort(time_s, kind="stable")
    return CurveData(path, title, names, (FIRST, SECOND), time_s[order], values[order])


def _at(track: Track, at_s: FloatArray) -> FloatArray:
    columns = [np.interp(at_s, track.time_s, track.position_enu_m[:, axis]) for axis in range(3)]
    return np.stack(columns, axis=-1)


def _sent_apart(
    first: Flight, second: Flight, path: str, starts_s: tuple[float, float]
) -> FloatArray | None:
    """Return the difference of the velocities sent, at times both have; ``None`` without."""
    lines = []
    for flight, start_s in zip((first, second), starts_s, strict=True):
        curve = flight.curves.get(path)
        name = (
            None
            if curve is None
            else next((n for n in ("sent", "setpoint") if n in curve.names), None)
        )
        if curve is None or name is None:
            return None
        time_s, values = _shifted(curve.line(name), start_s)
        if len(time_s) < 2:
            return None
        lines.append((time_s, values))
    end_s = min(line[0][-1] for line in lines)
    at_s = np.linspace(0.0, max(0.0, float(end_s)), _STEPS)
    return np.interp(at_s, *lines[0]) - np.interp(at_s, *lines[1])
