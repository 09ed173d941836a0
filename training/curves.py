"""Learning curves out of the logs of runs, and what several seeds of them have in common."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from companion.arrays import FloatArray

_STEPS = 100
_WINDOW = 4
"""Lines of the log."""
_POINTS = 200
"""On the common grid of several seeds."""


@dataclass(frozen=True, slots=True)
class Curve:
    """One quantity over the updates of one run; both ``(N,)``."""

    updates: FloatArray
    value: FloatArray


@dataclass(frozen=True, slots=True)
class Band:
    """Several seeds on one grid; all ``(N,)``."""

    updates: FloatArray
    mean: FloatArray
    low: FloatArray
    """Of the worst seed at each point,"""
    high: FloatArray
    """and of the best."""
    seeds: int


def read_log(path: Path) -> list[dict[str, Any]]:
    """Return the lines of a ``log.jsonl``; a last line cut short by a crash is left out."""
    entries = []
    for line in path.read_bytes().splitlines():
        try:
            entries.append(msgspec.json.decode(line, type=dict[str, Any]))
        except msgspec.DecodeError:
            break
    return entries


def training_curve(log: Sequence[dict[str, Any]], column: str) -> Curve:
    """Return a column of the training lines, without the lines that have no value for it."""
    rows = [
        (entry["updates"], entry[column])
        for entry in log
        if entry["kind"] == "training" and entry.get(column) is not None
    ]
    return _curve(rows)


def reward_curve(log: Sequence[dict[str, Any]], *, whole_episodes: bool) -> Curve:
    """Return the reward earned in 100 steps over the episodes' worth of 100 steps so far.

    Args:
        log: Of the run.
        whole_episodes: Whether every episode lasts 100 steps; its mean return is the answer then.
            Else it is what the episodes brought that ended in a window of the log, over its steps.
    """
    lines = [e for e in log if e["kind"] == "training" and e.get("return") is not None]
    if whole_episodes:
        return _curve([(line["steps"] / _STEPS, line["return"]) for line in lines])
    rows = []
    for end in range(_WINDOW, len(lines)):
        brought = sum(
            line["return"] * line["episodes"] for line in lines[end - _WINDOW + 1 : end + 1]
        )
        steps = lines[end]["steps"] - lines[end - _WINDOW]["steps"]
        rows.append((lines[end]["steps"] / _STEPS, _STEPS * brought / steps))
    return _curve(rows)


def saturation_curves(log: Sequence[dict[str, Any]]) -> tuple[Curve, Curve, Curve]:
    """Return the saturated share of rho, phi and psi."""
    lines = [entry for entry in log if entry["kind"] == "training"]
    first, second, third = (
        _curve([(entry["updates"], entry["saturated"][column]) for entry in lines])
        for column in range(3)
    )
    return first, second, third


def validation_curve(log: Sequence[dict[str, Any]], column: str = "completion_rate") -> Curve:
    """Return what the better of the actor and its average did on validation, over updates."""
    rows = [
        (entry["updates"], max(entry["actor"][column], entry["actor_average"][column]))
        for entry in log
        if entry["kind"] == "validation"
    ]
    return _curve(rows)


def band(curves: Sequence[Curve]) -> Band:
    """Return mean, least and largest value of several runs over the part that all of them have.

    Raises:
        ValueError: If there is no curve, or an empty one.
    """
    if not curves or any(len(curve.updates) == 0 for curve in curves):
        raise ValueError("need at least one curve, and none of them empty")
    first = max(curve.updates[0] for curve in curves)
    last = min(curve.updates[-1] for curve in curves)
    grid = np.linspace(first, max(first, last), _POINTS)
    values = np.stack([np.interp(grid, curve.updates, curve.value) for curve in curves])
    return Band(grid, values.mean(axis=0), values.min(axis=0), values.max(axis=0), len(curves))


def smoothed(curve: Curve, window: int) -> Curve:
    """Return the running mean of ``window`` points, shorter at both ends."""
    if window <= 1 or len(curve.value) == 0:
        return curve
    kernel = np.ones(min(window, len(curve.value)))
    total = np.convolve(curve.value, kernel, mode="same")
    count = np.convolve(np.ones_like(curve.value), kernel, mode="same")
    return Curve(curve.updates, total / count)


def _curve(rows: Sequence[tuple[float, float]]) -> Curve:
    table = np.array(rows, dtype=np.float64).reshape(-1, 2)
    return Curve(table[:, 0], table[:, 1])
