"""A flight as it is reviewed, wherever it was read from: a recording, or a telemetry log."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from companion.arrays import FloatArray
from companion.session.colors import Color
from companion.session.records import Event
from companion.session.summary import Summary


@dataclass(frozen=True)
class CurveData:
    """The lines of one plot."""

    path: str
    """As in ``companion.session.curves``: ``plots/speed``."""
    title: str
    names: tuple[str, ...]
    colors: tuple[Color, ...]
    time_s: FloatArray
    """Shape ``(N,)``."""
    values: FloatArray
    """Shape ``(N, lines)``; NaN is a gap."""

    def line(self, name: str) -> tuple[FloatArray, FloatArray]:
        """Return times and values of one line, without its gaps; empty if there is no such line.

        The names of limits go on with their value: ``margin`` finds ``margin 2 m``.
        """
        found = [full for full in self.names if full == name or full.startswith(f"{name} ")]
        if not found:
            return np.empty(0), np.empty(0)
        values = self.values[:, self.names.index(found[0])]
        known = np.isfinite(values)
        return self.time_s[known], values[known]


@dataclass(frozen=True)
class Track:
    """Where something went, map ENU."""

    time_s: FloatArray
    """Shape ``(N,)``."""
    position_enu_m: FloatArray
    """Shape ``(N, 3)``."""
    color: tuple[Color, ...] = ()
    """Of the piece that ends there; empty where nobody told."""


NOWHERE = Track(np.empty(0), np.empty((0, 3)))


@dataclass(frozen=True)
class City:
    """What stands around."""

    name: str
    size_m: tuple[float, float, float]
    footprints_m: tuple[FloatArray, ...] = ()
    heights_m: tuple[float, ...] = ()


@dataclass
class Flight:
    """Everything that a review shows."""

    path: Path
    title: str
    result: str
    """How it ended, in a line."""
    start_utc_us: int = 0
    duration_s: float = 0.0
    summary: Summary | None = None
    """Of a session of ours that ended in order."""
    facts: list[tuple[str, str]] = field(default_factory=list)
    """What was measured."""
    settings: list[tuple[str, str]] = field(default_factory=list)
    """What flew: vehicle, actor, map, options."""
    events: list[Event] = field(default_factory=list)
    """In order."""
    bands: dict[str, list[tuple[float, str]]] = field(default_factory=dict)
    """States by name, each from its time on."""
    curves: dict[str, CurveData] = field(default_factory=dict)
    """By their path."""
    vehicle: Track = NOWHERE
    target: Track = NOWHERE
    city: City | None = None
    recording: Path | None = None
    """What the viewer opens."""
    write_recording: Callable[[Path], None] | None = None
    """Writes it, where there is none yet."""
