"""What a report holds: ``numbers.json`` for its page, ``curves.json`` for its figures."""

from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

import msgspec
import numpy as np

from companion.arrays import FloatArray
from companion.errors import UsageError
from training.evaluate import Evaluation
from training.flights import Flight, Outcome

NUMBERS = "numbers.json"
CURVES = "curves.json"

Points = list[tuple[float, float]]


class Score(msgspec.Struct, frozen=True):
    """How one policy did on the test cases of one map."""

    evaluation: Evaluation
    spl_shortest: float | None
    """Success weighted by path length, against the shortest way around the obstacles; ``None``
    for moving targets, whose shortest way nobody can know."""
    mean_return: float
    """Undiscounted reward of an episode of T steps."""


class RunResult(msgspec.Struct, frozen=True):
    """One training run and what became of it."""

    name: str
    group: str
    """``free``, ``obstacles``, ``coordinates`` or ``ablation``."""
    variant: str
    """What was changed: ``paper`` for the recipe as it is, else the ablation's name."""
    map: str
    seed: int
    updates: int
    preset_digest: str
    init: str | None
    """Name of the run whose networks it started from."""
    git_revision: str
    """Of the code that trained it."""
    source: str
    """Which actor was best on validation, and after how many updates."""
    train_s: float | None
    """Wall-clock, where the log tells it."""
    static: Score
    moving: Score | None
    machine: str = ""
    """Where it was trained; earlier reports did not note it."""


class RunCurves(msgspec.Struct, frozen=True):
    """How one run went."""

    rewards: Points
    """Episodes' worth of 100 steps so far, reward in 100 steps."""
    validation: Points
    """Updates, completion rate of the better of the actor and its average."""


class Baseline(msgspec.Struct, frozen=True):
    """Floor and ceiling of one map's cases."""

    map: str
    moving: bool
    straight: Score
    planner: Score


class FlightRecord(msgspec.Struct, frozen=True):
    """One drawn case; points rounded to a centimetre."""

    position_enu_m: list[tuple[float, float, float]]
    target_enu_m: list[tuple[float, float, float]]
    outcome: Outcome

    @classmethod
    def of(cls, flight: Flight) -> "FlightRecord":
        """Return a flight as it is written down."""
        return cls(_rounded(flight.position_enu_m), _rounded(flight.target_enu_m), flight.outcome)

    def flight(self) -> Flight:
        """Return the flight again."""
        return Flight(np.array(self.position_enu_m), np.array(self.target_enu_m), self.outcome)


class Scene(msgspec.Struct, frozen=True):
    """One panel of a figure of paths."""

    title: str
    map: str
    choice: str
    """How the case was chosen, for the reader who suspects cherry-picking."""
    flight: FlightRecord | None
    """``None`` where no test case fits."""


class Change(msgspec.Struct, frozen=True):
    """One row of the ablation table, without its numbers."""

    name: str
    reason: str


class Report(msgspec.Struct, frozen=True):
    """Everything."""

    quick: bool
    command: str
    git_revision: str
    finished_utc: str
    wall_s: float
    """Of this call; runs that were reused took theirs before."""
    machine: str
    """Where the test cases were flown."""
    versions: dict[str, str]
    seeds: list[int]
    cases: int
    test_seed: int
    updates: dict[str, int]
    """Of each kind of run."""
    paper_updates: int
    runs: list[RunResult]
    baselines: list[Baseline]
    changes: list[Change]
    recipe: list[tuple[str, str, str]]
    """What, the paper's, ours."""
    unfinished: list[str]
    """Runs that were planned and have not come to their end."""
    coordinates_recipe: list[tuple[str, str, str]] = []
    """Likewise, of the runs from six coordinates alone; empty where there are none."""

    def of(self, group: str, map_name: str, variant: str = "paper") -> list[RunResult]:
        """Return the runs of a group on a map, by seed."""
        found = [
            run
            for run in self.runs
            if (run.group, run.map, run.variant) == (group, map_name, variant)
        ]
        return sorted(found, key=lambda run: run.seed)

    def baseline(self, map_name: str, *, moving: bool = False) -> Baseline | None:
        """Return floor and ceiling of a map."""
        for entry in self.baselines:
            if (entry.map, entry.moving) == (map_name, moving):
                return entry
        return None


class Drawn(msgspec.Struct, frozen=True):
    """What the figures show beside the numbers."""

    curves: dict[str, RunCurves]
    """By name of the run."""
    paths: list[Scene]
    """Figure 6."""
    chases: list[Scene]
    """Figure 5 and its like among obstacles."""


def write_report(report: Report, drawn: Drawn, folder: Path) -> None:
    """Write ``numbers.json`` and ``curves.json``."""
    folder.mkdir(parents=True, exist_ok=True)
    numbers = msgspec.json.format(msgspec.json.encode(report), indent=2)
    (folder / NUMBERS).write_bytes(numbers + b"\n")
    (folder / CURVES).write_bytes(msgspec.json.encode(drawn) + b"\n")


def read_report(folder: Path) -> tuple[Report, Drawn]:
    """Return the report of a folder.

    Raises:
        UsageError: If there is none, or it is not one of ours.
    """
    return _read(folder / NUMBERS, Report), _read(folder / CURVES, Drawn)


_Kind = TypeVar("_Kind", Report, Drawn)


def _read(path: Path, kind: type[_Kind]) -> _Kind:
    try:
        return msgspec.json.decode(path.read_bytes(), type=kind)
    except OSError as error:
        raise UsageError(f"{path.parent} holds no report: {path.name}: {error.strerror}") from error
    except msgspec.DecodeError as error:
        raise UsageError(f"cannot read {path}: {error}") from error


def thinned(updates: FloatArray, values: FloatArray, most: int = 200) -> Points:
    """Return at most ``most`` points of a curve, rounded to what a figure can show."""
    rows: Sequence[int] = np.unique(
        np.linspace(0, len(updates) - 1, min(most, len(updates))).round().astype(int)
    ).tolist()
    return [(float(updates[row]), round(float(values[row]), 4)) for row in rows]


def _rounded(points_m: FloatArray) -> list[tuple[float, float, float]]:
    return [(x, y, z) for x, y, z in np.round(points_m, 2).tolist()]
