"""The report's tables of results: Table II, every seed, moving targets."""

import numpy as np

from training.report_data import Baseline, Report, RunResult, Score
from training.report_words import (
    PAPER_RATES,
    another_seed,
    mean,
    minutes,
    percent,
    spread,
    table,
)

TITLES = {"free": "obstacle free", "env1": "obstacles, env1", "env2": "obstacles, env2"}


def table_two(report: Report) -> str:
    """Return Table II beside the paper's, with floor and ceiling."""
    rows = []
    for name, paper in PAPER_RATES.items():
        runs, base = _main_runs(report, name), report.baseline(name)
        rows.append(
            [
                TITLES[name],
                f"{100 * paper:.0f} %",
                spread([run.static.evaluation.completion_rate for run in runs]),
                another_seed([run.static.evaluation.completion_rate for run in runs]),
                _of_base(base, "straight"),
                _of_base(base, "planner"),
                mean([run.static.evaluation.completion_2m for run in runs]),
                mean([run.static.evaluation.completion_1m for run in runs]),
            ]
        )
    heading = [
        "Scenario",
        "paper",
        "ours: mean (min - max)",
        "one more seed (95 %)",
        "flying straight",
        "planner",
        "ours at 2 m",
        "at 1 m",
    ]
    return table(heading, rows)


def verdict(report: Report) -> str:
    """Return which of the paper's rates are reached."""
    lines = []
    for name, paper in PAPER_RATES.items():
        rates = [run.static.evaluation.completion_rate for run in _main_runs(report, name)]
        if not rates:
            lines.append(f"- {TITLES[name]}: no run came to its end.")
            continue
        average, least = float(np.mean(rates)), min(rates)
        if least >= paper:
            said = "every seed reaches the paper's rate"
        elif average >= paper:
            said = "the mean reaches the paper's rate, the worst seed does not"
        else:
            said = f"**below the paper's rate** by {100 * (paper - average):.1f} points on average"
        lines.append(f"- {TITLES[name]}: {said}.")
    return "\n".join(lines)


def reward_note(report: Report) -> str:
    """Return what rewards do not tell."""
    base = report.baseline("env1")
    if base is None:
        return ""
    return (
        "Rewards of an episode do not tell completion: on env1 flying straight through whatever "
        f"is in the way earns {base.straight.mean_return:.2f} an episode, the planner that never "
        f"touches anything {base.planner.mean_return:.2f}. A crash is paid for once, the target "
        "pays at every step. Where episodes end on contact or by chance, as in the recipe, more of "
        "the steps are spent on the way: the curves stay below the lines, which are of whole "
        "episodes."
    )


def every_seed(report: Report) -> str:
    """Return a row for every run of the recipe, and for floor and ceiling."""
    rows = []
    for name in PAPER_RATES:
        rows += [
            [TITLES[name], f"seed {run.seed}", *_cells(run.static), *_effort(run)]
            for run in _main_runs(report, name)
        ]
        base = report.baseline(name)
        if base is not None:
            rows.append([TITLES[name], "flying straight", *_cells(base.straight), "", "", ""])
            rows.append([TITLES[name], "planner", *_cells(base.planner), "", "", ""])
    return table(
        ["Scenario", "policy", *_CELLS, "updates", "training", "actor chosen on validation"], rows
    )


_CELLS = (
    "within 5 m (95 %)",
    "2 m",
    "1 m",
    "collided",
    "timed out",
    "SPL",
    "SPL, ways",
    "mean reward",
)


def _cells(score: Score) -> list[str]:
    result = score.evaluation
    low, high = result.completion_rate_ci95
    ways = score.spl_shortest
    return [
        f"{percent(result.completion_rate)} ({100 * low:.1f} - {100 * high:.1f})",
        percent(result.completion_2m),
        percent(result.completion_1m),
        percent(result.collision_rate),
        percent(result.timeout_rate),
        f"{result.spl:.3f}",
        "-" if ways is None else f"{ways:.3f}",
        f"{score.mean_return:.2f}",
    ]


def _effort(run: RunResult) -> list[str]:
    return [f"{run.updates:,}", minutes(run.train_s), run.source]


def moving_targets(report: Report) -> str:
    """Return the rates on targets that move."""
    rows = []
    for name in PAPER_RATES:
        scores = [run.moving for run in _main_runs(report, name) if run.moving is not None]
        base = report.baseline(name, moving=True)
        rows.append(
            [
                TITLES[name],
                spread([score.evaluation.completion_rate for score in scores]),
                mean([score.evaluation.completion_2m for score in scores]),
                mean([score.evaluation.completion_1m for score in scores]),
                mean([score.evaluation.collision_rate for score in scores]),
                _of_base(base, "straight"),
                _of_base(base, "planner"),
            ]
        )
    heading = [
        "Scenario",
        "within 5 m: mean (min - max)",
        "2 m",
        "1 m",
        "collided",
        "flying straight",
        "planner",
    ]
    return table(heading, rows)


def _main_runs(report: Report, map_name: str) -> list[RunResult]:
    return report.of("free" if map_name == "free" else "obstacles", map_name)


def _of_base(base: Baseline | None, which: str) -> str:
    if base is None:
        return "-"
    score: Score = getattr(base, which)
    return percent(score.evaluation.completion_rate)
