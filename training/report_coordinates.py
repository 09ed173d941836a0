"""The part of a report on what the paper's six coordinates alone can do."""

import numpy as np

from training.report_data import Report
from training.report_words import (
    PAPER_RATES,
    another_seed,
    listed,
    minutes,
    percent,
    spread,
    table,
)
from training.reproduce_plan import OBSTACLE_MAPS


def coordinates_sentence(report: Report) -> str:
    """Return how far six coordinates go, in one sentence; empty where nobody tried."""
    found = [
        f"{percent(_mean_rate(report, name))} of {name}"
        for name in OBSTACLE_MAPS
        if report.of("coordinates", name)
    ]
    if not found:
        return ""
    return (
        f" From its six coordinates alone, with additions to the algorithm, {listed(found)} "
        "were completed: see *Six coordinates*."
    )


def coordinates_section(report: Report, figure: str) -> list[str]:
    """Return the paragraphs; none where nobody tried.

    Args:
        report: The numbers.
        figure: The curves, as Markdown.
    """
    totals, rows = [], []
    for name in OBSTACLE_MAPS:
        runs, base = report.of("coordinates", name), report.baseline(name)
        if not runs:
            continue
        rates = [run.static.evaluation.completion_rate for run in runs]
        totals.append(
            [
                name,
                f"{100 * PAPER_RATES[name]:.0f} %",
                spread(rates),
                another_seed(rates),
                "-" if base is None else percent(base.straight.evaluation.completion_rate),
            ]
        )
        for run in runs:
            result = run.static.evaluation
            low, high = result.completion_rate_ci95
            rows.append(
                [
                    name,
                    f"{run.seed}",
                    f"{percent(result.completion_rate)} ({100 * low:.1f} - {100 * high:.1f})",
                    percent(result.completion_2m),
                    percent(result.completion_1m),
                    percent(result.collision_rate),
                    percent(result.timeout_rate),
                    f"{run.updates:,}",
                    minutes(run.train_s),
                    run.source,
                ]
            )
    if not rows:
        return []
    main = {what: ours for what, _, ours in report.recipe}
    differing = [
        [what, paper, main[what], ours]
        for what, paper, ours in report.coordinates_recipe
        if main[what] != ours
    ]
    heading = [
        "map",
        "seed",
        "within 5 m (95 %)",
        "2 m",
        "1 m",
        "collided",
        "timed out",
        "updates",
        "training",
        "actor chosen on validation",
    ]
    return [
        "## Six coordinates",
        "The paper's vehicle knows where it is and where its destination is, nothing else: it must "
        "learn a map by heart. So does preset `coordinates`: its state (layout `relative`) is "
        "computed from those six numbers alone. Its reward, T, N and tau are the paper's; what is "
        "not, and is not the recipe's above either, is named below. From random networks, no "
        "transfer; test cases as in Table II.",
        table(
            [
                "map",
                "paper",
                "here: mean (min - max)",
                "one more seed (95 %)",
                "flying straight",
            ],
            totals,
        ),
        table(heading, rows),
        figure,
        table(["What", "paper", "recipe above", "six coordinates"], differing),
        "One of these runs: `training train --preset coordinates --stage obstacles --map env1 "
        "--seed 1`.",
    ]


def _mean_rate(report: Report, name: str) -> float:
    runs = report.of("coordinates", name)
    return float(np.mean([run.static.evaluation.completion_rate for run in runs]))
