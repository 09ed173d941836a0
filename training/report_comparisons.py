"""The report's comparisons on env1: transfer, one change at a time, two readings of beta."""

import numpy as np

from training.report_data import Report
from training.report_words import listed, mean, percent, spread, table
from training.reproduce_plan import ACTOR_ONLY, BETA, RECIPE, SCRATCH

STARTS = {
    RECIPE: "from the free actor and critic",
    ACTOR_ONLY: "from the free actor alone",
    SCRATCH: "from scratch",
}
"""Variants that differ in nothing but the networks they start from."""


def what_transfer_buys(report: Report) -> str:
    """Return the comparison of what the networks start from, and its verdict."""
    rows, averages = [], {}
    for variant, label in STARTS.items():
        runs = report.of("ablation", "env1", variant)
        if runs:
            rates = [run.static.evaluation.completion_rate for run in runs]
            averages[variant] = 100.0 * float(np.mean(rates))
            seeds = listed([run.seed for run in runs])
            rows.append([label, f"{runs[0].updates:,}", seeds, spread(rates)])
        else:
            rows.append([label, "", "", "not finished"])
    if not averages:
        return "No run of this comparison came to its end."
    rows += [[name, "", "", rate] for name, rate, _ in _floor_and_ceiling(report)]
    shown = table(["env1", "updates", "seeds", "test cases: mean (min - max)"], rows)
    verdict = []
    if RECIPE in averages and SCRATCH in averages:
        gain = averages[RECIPE] - averages[SCRATCH]
        verdict.append(
            f"Here transfer buys {gain:.1f} points."
            if gain > 0.0
            else f"**Here transfer does not pay**: from scratch the same updates bring {-gain:.1f} "
            "points more."
        )
    if ACTOR_ONLY in averages and len(averages) == len(STARTS):
        against_both = averages[ACTOR_ONLY] - averages[RECIPE]
        critic = (
            "The critic of the free stage, which has seen no obstacle, is in the way: with"
            if against_both > 0.0
            else "The critic of the free stage is not the cause: with"
        )
        verdict.append(
            f"{critic} a random one instead the free actor comes to "
            f"{averages[ACTOR_ONLY]:.1f} %, {against_both:+.1f} points against both, "
            f"{averages[ACTOR_ONLY] - averages[SCRATCH]:+.1f} against neither."
        )
    return "\n\n".join(
        (
            "The same recipe, seeds and updates on env1, from the networks of the free stage "
            "(actor, critic and both targets; optimisers, buffer and epsilon begin anew), from its "
            "actor alone, and from random ones. All are shorter than the runs of Table II.",
            shown,
            *([" ".join(verdict)] if verdict else []),
        )
    )


def one_change_at_a_time(report: Report) -> str:
    """Return the table of ablations, and which differences mean something."""
    rows = []
    for change in report.changes:
        runs = report.of("ablation", "env1", change.name)
        if not runs:
            rows.append([change.name, change.reason, "", "", "not finished", "", "", ""])
            continue
        results = [run.static.evaluation for run in runs]
        rows.append(
            [
                change.name,
                change.reason,
                f"{runs[0].updates:,}",
                listed([run.seed for run in runs]),
                spread([result.completion_rate for result in results]),
                mean([result.collision_rate for result in results]),
                mean([result.timeout_rate for result in results]),
                f"{np.mean([result.spl for result in results]):.3f}",
            ]
        )
    heading = ["change", "why", "updates", "seeds", "within 5 m", "collided", "timed out", "SPL"]
    rows += [
        [name, "", "", "", rate, collided, "", ""]
        for name, rate, collided in _floor_and_ceiling(report)
    ]
    return (
        "Each row is the recipe with one thing changed, trained on env1 for fewer updates than "
        "the runs of Table II so that all of them fit; compare rows with the first one, not with "
        "Table II.\n\n" + table(heading, rows) + _noise_note(report)
    )


def _noise_note(report: Report) -> str:
    """Return what the seeds of the unchanged recipe say about differences between rows."""
    rates = [run.static.evaluation.completion_rate for run in report.of("ablation", "env1", RECIPE)]
    if len(rates) < 2:
        return ""
    low, high = min(rates), max(rates)
    others = {
        change.name: [
            run.static.evaluation.completion_rate
            for run in report.of("ablation", "env1", change.name)
        ]
        for change in report.changes[1:]
    }
    above = [name for name, found in others.items() if found and min(found) > high]
    below = [name for name, found in others.items() if found and max(found) < low]
    return (
        f"\n\nThe seeds of the unchanged recipe are {100.0 * (high - low):.1f} points apart: "
        "smaller differences mean nothing. At this budget "
        f"{listed(above) or 'no change'} complete more than its best seed, "
        f"{listed(below) or 'no change'} less than its worst."
    )


def two_readings_of_beta(report: Report) -> str:
    """Return the comparison of the two values of E4."""
    literal = report.of("ablation", "env1", BETA.name)
    ours = report.of("ablation", "env1", "paper")
    if not literal or not ours:
        return ""
    rows = []
    for beta, runs in (("0.8: the ratio beta / (1 - beta) is 4", ours), ("0.4", literal)):
        results = [run.static.evaluation for run in runs]
        rows.append(
            [
                beta,
                listed([run.seed for run in runs]),
                spread([result.completion_rate for result in results]),
                mean([result.collision_rate for result in results]),
                mean([result.timeout_rate for result in results]),
            ]
        )
    rows += [[name, "", rate, collided, ""] for name, rate, collided in _floor_and_ceiling(report)]
    heading = ["beta", "seeds", "within 5 m", "collided", "timed out"]
    return (
        f"Two readings of E4 on env1, {ours[0].updates:,} updates each. The literal value 4 is "
        "refused by the command line: it pays for staying away.\n\n" + table(heading, rows)
    )


def _floor_and_ceiling(report: Report) -> list[tuple[str, str, str]]:
    """Return name, completion and collisions of what flies env1 without learning."""
    base = report.baseline("env1")
    if base is None:
        return []
    return [
        (name, percent(result.completion_rate), percent(result.collision_rate))
        for name, result in (
            ("flying straight", base.straight.evaluation),
            ("planner", base.planner.evaluation),
        )
    ]
