"""Ticks into the curves of ``companion.session.curves``."""

from collections.abc import Sequence

import numpy as np
import rerun as rr

from companion.session import curves
from companion.session.colors import cycle
from companion.session.curves import Curve, Line
from companion.session.log_curves import LOG_CURVES
from companion.session.records import SessionStart, Tick
from companion.session.writer import StreamWriter


class Plots:
    """Logs every curve, a batch of ticks at a time."""

    def __init__(self, writer: StreamWriter, start: SessionStart) -> None:
        """Name and colour the lines."""
        self._writer = writer
        self._start = start
        self._rates: set[str] = set()
        self._curves = curves.CURVES if start.actor.name else LOG_CURVES
        for curve in self._curves:
            writer.static(curve.path, _style([line.named(start) for line in curve.lines]))
        columns = start.actor.columns
        self._observed = curves.observation_groups(columns)
        for path, shown in self._observed.items():
            lines = [Line(columns[column], cycle(index), 1.2) for index, column in enumerate(shown)]
            writer.static(path, _style(lines))
        shield = curves.INTERVENED
        writer.static(
            curves.INTERVENED_PATH,
            rr.SeriesPoints(
                names=[shield.name], colors=[shield.color], marker_sizes=[shield.width]
            ),
        )

    def send(self, ticks: Sequence[Tick]) -> None:
        """Send one batch."""
        for curve in self._curves:
            self._send_curve(curve, ticks)
        self._send_interventions(ticks)
        self._send_observation(ticks)
        self._send_rates(ticks)

    def _send_curve(self, curve: Curve, ticks: Sequence[Tick]) -> None:
        time_s, values = curve.rows(ticks, self._start)
        if len(time_s):
            self._writer.scalars(curve.path, time_s, values)

    def _send_interventions(self, ticks: Sequence[Tick]) -> None:
        rows = [
            (tick.time_s, tick.clearance_m)
            for tick in ticks
            if tick.intervened and tick.clearance_m is not None
        ]
        if rows:
            time_s, clearance_m = zip(*rows, strict=True)
            self._writer.scalars(curves.INTERVENED_PATH, time_s, clearance_m)

    def _send_observation(self, ticks: Sequence[Tick]) -> None:
        rows = [(tick.time_s, tick.observation) for tick in ticks if tick.observation is not None]
        if rows:
            time_s, observations = zip(*rows, strict=True)
            observation = np.array(observations)
            for path, shown in self._observed.items():
                self._writer.scalars(path, time_s, observation[:, shown])

    def _send_rates(self, ticks: Sequence[Tick]) -> None:
        rows: dict[str, list[tuple[float, float]]] = {}
        for tick in ticks:
            for name, rate_hz in (tick.rates_hz or {}).items():
                rows.setdefault(name, []).append((tick.time_s, rate_hz))
        for name, of_name in rows.items():
            path = f"{curves.RATES_PATH}/{rr.escape_entity_path_part(name)}"
            if name not in self._rates:
                self._writer.static(path, _style([Line(name, cycle(len(self._rates)))]))
                self._rates.add(name)
            time_s, rates_hz = zip(*of_name, strict=True)
            self._writer.scalars(path, time_s, rates_hz)


def _style(lines: Sequence[Line]) -> rr.SeriesLines:
    return rr.SeriesLines(
        names=[line.name for line in lines],
        colors=[line.color for line in lines],
        widths=[line.width for line in lines],
    )
