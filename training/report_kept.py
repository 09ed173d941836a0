"""What an earlier report says of runs that are planned again: measured once is enough.

Checkpoints are large and get deleted; a report is small and stays. A run of the same preset, seed
and start need not be made a second time for the next report.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from training.evaluate import fly_straight
from training.report_data import NUMBERS, Drawn, Report, RunResult, Scene, read_report
from training.report_measure import TEST_SEED, Cases
from training.reproduce_plan import Job


@dataclass(frozen=True, slots=True)
class Kept:
    """What can be taken over."""

    runs: list[RunResult]
    drawn: Drawn


def kept_runs(folder: Path, jobs: Sequence[Job], cases: Cases) -> Kept:
    """Return the results of planned runs that an earlier report holds, and what it has drawn.

    A run that another one without a result starts from is not among them: its networks are needed.

    Args:
        folder: Of the earlier report.
        jobs: Each after the one it starts from.
        cases: Must be those of the report: flying straight must still do as it did there.
    """
    nothing = Kept([], Drawn(curves={}, paths=[], chases=[]))
    if not (folder / NUMBERS).exists():
        return nothing
    report, drawn = read_report(folder)
    if (report.cases, report.test_seed) != (cases.count, TEST_SEED):
        return nothing
    same = {city for city in {job.map for job in jobs} if _same_cases(report, city, cases)}
    results = {run.name: run for run in report.runs if run.map in same and run.name in drawn.curves}
    kept: list[RunResult] = []
    sources: set[str | None] = set()
    for job in reversed(jobs):
        result = results.get(job.name)
        if result is not None and job.name not in sources and _is_of(result, job):
            kept.append(result)
        else:
            sources.add(job.init)
    return Kept(kept[::-1], drawn)


def newest(earlier: Iterable[Scene], later: Iterable[Scene]) -> list[Scene]:
    """Return the panels of two reports, of those with one title the later."""
    return list({scene.title: scene for scene in (*earlier, *later)}.values())


def _is_of(result: RunResult, job: Job) -> bool:
    return (result.preset_digest, result.seed, result.map, result.init) == (
        job.preset.digest,
        job.seed,
        job.map,
        job.init,
    )


def _same_cases(report: Report, city: str, cases: Cases) -> bool:
    before = report.baseline(city)
    if before is None:
        return False
    now, _ = cases.fly(fly_straight, city)
    return (now.mean_return, now.evaluation.spl) == (
        before.straight.mean_return,
        before.straight.evaluation.spl,
    )
