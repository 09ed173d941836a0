"""``training reproduce``: the whole paper, from the first update to the last figure."""

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from companion.errors import UsageError
from companion.world.maps import load_map
from training import cli
from training.ablations import ABLATIONS
from training.export import git_revision
from training.figures import draw_all
from training.flights import Flights
from training.machine import describe_machine, library_versions, utc_text
from training.report_data import (
    Change,
    Drawn,
    Report,
    RunCurves,
    RunResult,
    Scene,
    read_report,
    write_report,
)
from training.report_kept import kept_runs, newest
from training.report_measure import TEST_SEED, Cases, measure_run
from training.report_page import write_page
from training.report_recipe import recipe
from training.reproduce_plan import ACTOR_ONLY, BETA, FULL, QUICK, RECIPE, SCRATCH, Job, plan
from training.reproduce_run import Run, find_run
from training.run_folder import RunFolder
from training.scenes import across, chase
from training.train import stop_on_signal
from training.workers import do_all

PAGE = "README.md"
CHANGES = {**ABLATIONS, BETA.name: BETA}
INTERRUPTED = 130
PAPER_UPDATES = 4_000_000
"""M = 40000 episodes of T = 100 steps, one update a step."""


def reproduce(options: "cli.Reproduce", typed: str, *, now_s: Callable[[], float]) -> int:
    """Run ``training reproduce``.

    Raises:
        UsageError: If an option makes no sense.
    """
    began_s = now_s()
    console = Console()
    budget = QUICK if options.quick else FULL
    seeds = tuple(options.seeds) or ((1,) if options.quick else (1, 2, 3))
    if len(set(seeds)) < len(seeds):
        raise UsageError(f"--seeds must all be different, got {' '.join(map(str, seeds))}")
    processes = os.cpu_count() or 1 if options.processes is None else options.processes
    if processes < 1:
        raise UsageError(f"--processes must be at least 1, got {processes}")
    out = options.out or Path("runs") / ("report-quick" if options.quick else "report")
    jobs = plan(budget, seeds, CHANGES)
    cases = Cases(budget.cases, now_s)
    kept = kept_runs(out, jobs, cases)
    for run in kept.runs:
        console.print(f"{run.name}: measured before, {out}", highlight=False, soft_wrap=True)
    known = {run.name for run in kept.runs}
    new = [job for job in jobs if job.name not in known]

    with stop_on_signal() as stop:
        folders, left = train_all(new, options.runs, typed, processes, console, stop)
        stopped = stop()
    if left:
        for name, reason in left.items():
            console.print(f"{name}: {reason}", highlight=False)
    console.print(f"flying {budget.cases} test cases a map with {len(folders)} actors")
    measured, drawn = measure_all(
        [job for job in new if job.name in folders], folders, cases, shown_seed=seeds[0]
    )
    by_name = {run.name: run for run in (*kept.runs, *measured)}
    runs = [by_name[job.name] for job in jobs if job.name in by_name]
    drawn = Drawn(
        curves={run.name: {**kept.drawn.curves, **drawn.curves}[run.name] for run in runs},
        paths=newest(kept.drawn.paths, drawn.paths),
        chases=newest(kept.drawn.chases, drawn.chases),
    )
    report = Report(
        quick=options.quick,
        command=typed,
        git_revision=git_revision(),
        finished_utc=utc_text(),
        wall_s=now_s() - began_s,
        machine=describe_machine(),
        versions=library_versions(),
        seeds=list(seeds),
        cases=budget.cases,
        test_seed=TEST_SEED,
        updates=_updates(jobs),
        paper_updates=PAPER_UPDATES,
        runs=runs,
        baselines=cases.baselines(),
        changes=_changes(),
        recipe=_recipe(jobs),
        coordinates_recipe=_coordinates_recipe(jobs),
        unfinished=list(left),
    )
    write_report(report, drawn, out)
    write_figures(out)
    console.print(f"wrote {out / PAGE}", soft_wrap=True)
    if stopped:
        console.print("stopped before the end: the same command goes on")
    return INTERRUPTED if stopped else (1 if left else 0)


def figures(options: "cli.Figures") -> int:
    """Run ``training figures``.

    Raises:
        UsageError: If there is no report in the folder.
    """
    for name in write_figures(options.report):
        print(f"wrote {options.report / name}")
    return 0


def write_figures(folder: Path) -> list[str]:
    """Draw the figures of a report again, and write its page."""
    report, drawn = read_report(folder)
    names = draw_all(report, drawn, folder)
    (folder / PAGE).write_text(write_page(report, names))
    return names


def train_all(
    jobs: Sequence[Job],
    runs: Path,
    typed: str,
    processes: int,
    console: Console,
    stop: Callable[[], bool],
) -> tuple[dict[str, Path], dict[str, str]]:
    """Train what is not trained yet.

    Args:
        jobs: Each after the one it starts from.
        runs: Folder of training runs; new ones go into its ``reproduce``, finished ones that
            match are used wherever in it they lie.
        typed: The command, for the records.
        processes: How many runs at a time.
        console: Where progress is shown.
        stop: Whether to leave off.

    Returns:
        The folders of all runs that are over, and why the others are not.
    """
    others = sorted(path.parent for path in runs.glob("*/run.json"))
    folders: dict[str, Path] = {}
    over: set[str] = set()
    works: list[Run] = []
    for job in jobs:
        own = runs / "reproduce" / job.label
        init = None if job.init is None else folders[job.init]
        found = find_run(job, own, init if job.init in over else None, others)
        folders[job.name] = found or own
        if found is not None:
            over.add(job.name)
            console.print(f"{job.name}: done before, {found}", highlight=False, soft_wrap=True)
            continue
        after = job.init if job.init not in over else None
        works.append(Run(job, own, init, after, typed))
    with _Reporter(console, works) as reporter:
        left = do_all(works, processes=processes, told=reporter.told, stop=stop)
    return {name: path for name, path in folders.items() if name not in left}, left


def measure_all(
    jobs: Sequence[Job], folders: Mapping[str, Path], cases: Cases, *, shown_seed: int
) -> tuple[list[RunResult], Drawn]:
    """Fly the test cases with every actor, and choose what the figures show of one seed."""
    results: list[RunResult] = []
    curves: dict[str, RunCurves] = {}
    shown: dict[str, tuple[Flights, Flights]] = {}
    for job in jobs:
        result, curve, flights, chases = measure_run(job, RunFolder(folders[job.name]), cases)
        if job.group == "free" and job.variant != RECIPE:
            continue  # only a source of networks
        results.append(result)
        curves[job.name] = curve
        if chases is not None and job.group != "coordinates" and job.seed == shown_seed:
            shown.setdefault(job.map, (flights, chases))
    return results, Drawn(curves=curves, paths=_paths(shown), chases=_chases(shown))


def _paths(shown: Mapping[str, tuple[Flights, Flights]]) -> list[Scene]:
    """Return the panels of Figure 6, flown by the actors of the first seed."""
    return [
        across(shown[name][0], load_map(name), obstacle, title=title, over=over)
        for name, obstacle, title, over in (
            ("env1", "obs2", "env1: around obs2", False),
            ("env2", "obs2", "env2: over obs2", True),
            ("env2", "obs6", "env2: over obs6", True),
        )
        if name in shown
    ]


def _chases(shown: Mapping[str, tuple[Flights, Flights]]) -> list[Scene]:
    return [
        chase(chases, load_map(name), title=f"{name}: seen from above")
        for name, (_, chases) in shown.items()
    ]


def _recipe(jobs: Sequence[Job]) -> list[tuple[str, str, str]]:
    free, obstacles = (
        next(job.preset for job in jobs if job.group == group) for group in ("free", "obstacles")
    )
    return recipe(free, obstacles)


def _coordinates_recipe(jobs: Sequence[Job]) -> list[tuple[str, str, str]]:
    presets = [job.preset for job in jobs if job.group == "coordinates"]
    return recipe(presets[0], presets[0]) if presets else []


def _updates(jobs: Sequence[Job]) -> dict[str, int]:
    return {
        group: next(job.preset.updates for job in jobs if job.group == group)
        for group in ("free", "obstacles", "coordinates", "ablation")
        if any(job.group == group for job in jobs)
    }


def _changes() -> list[Change]:
    return [
        Change(RECIPE, "the recipe as it is"),
        Change(SCRATCH, "random networks instead of those of the free stage"),
        Change(ACTOR_ONLY, "a random critic instead of that of the free stage"),
        *(Change(name, ablation.reason) for name, ablation in CHANGES.items()),
    ]


class _Reporter:
    """Shows all runs: bars on a terminal, plain lines otherwise."""

    def __init__(self, console: Console, works: Sequence[Run]) -> None:
        self._console = console
        self._bars = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.completed}/{task.total} updates"),
            TimeRemainingColumn(),
            console=console,
            disable=not console.is_terminal,
        )
        self._total = {work.name: work.job.preset.updates for work in works}
        self._all = self._bars.add_task("all runs", total=sum(self._total.values()))
        self._done = dict.fromkeys(self._total, 0)
        self._tasks: dict[str, TaskID] = {}
        self._tenth = dict.fromkeys(self._total, -1)

    def __enter__(self) -> "_Reporter":
        self._bars.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._bars.stop()

    def told(self, name: str, updates: int) -> None:
        """Show how far a run is."""
        total = self._total[name]
        self._done[name] = updates
        if name not in self._tasks:
            self._tasks[name] = self._bars.add_task(name, total=total)
        self._bars.update(self._tasks[name], completed=updates, visible=updates < total)
        self._bars.update(self._all, completed=sum(self._done.values()))
        tenth = 10 * updates // total
        if tenth > self._tenth[name]:
            self._tenth[name] = tenth
            if not self._console.is_terminal:
                line = f"{name}: {updates} of {total} updates"
                self._console.print(line, highlight=False, soft_wrap=True)
