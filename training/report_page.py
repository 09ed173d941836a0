"""The report's page: tables out of ``numbers.json``, with the figures between them."""

from collections.abc import Sequence

import numpy as np

from training.report_coordinates import coordinates_section, coordinates_sentence
from training.report_data import Baseline, Report, RunResult, Score
from training.report_errata import ERRATA
from training.report_made import budget, how_it_was_made
from training.report_words import (
    PAPER_RATES,
    another_seed,
    listed,
    listed_by_seed,
    mean,
    minutes,
    percent,
    spread,
    table,
)
from training.reproduce_plan import ACTOR_ONLY, BETA, RECIPE, SCRATCH

STARTS = {
    RECIPE: "from the free actor and critic",
    ACTOR_ONLY: "from the free actor alone",
    SCRATCH: "from scratch",
}
"""Variants that differ in nothing but the networks they start from."""
TITLES = {"free": "obstacle free", "env1": "obstacles, env1", "env2": "obstacles, env2"}

COORDINATES = "coordinates.png"
FIGURE_8 = "figure8-rewards.png"
FIGURE_6 = "figure6-paths.png"
FIGURE_5 = "figure5-chase-free.png"
CHASES = "chase-{map}.png"
TRANSFER = "transfer.png"
ABLATIONS = "ablations.png"


def write_page(report: Report, figures: Sequence[str]) -> str:
    """Return ``README.md``.

    Args:
        report: The numbers.
        figures: File names of those that were drawn; the others are left out.
    """
    parts = [
        "# The paper, reproduced",
        _banner(report),
        "Bouhamed, Ghazzai, Besbes, Massoud: *Autonomous UAV Navigation: A DDPG-based Deep "
        "Reinforcement Learning Approach* (ISCAS 2020): its Table II and Figures 5, 6 and 8, by "
        "preset `paper`. Everything here was written by one command:",
        f"```\n{report.command}\n```",
        "## What is the paper's and what is not",
        _departures(report),
        "## Table II",
        _table_two(report),
        "Rates are shares of the test cases that came within 5 m of the target without touching "
        "an obstacle before, policy alone, no shield. *Mean (min - max)* is over training seeds "
        f"{listed(report.seeds)}: no seed was left out; *one more seed* is where another is to be "
        "expected, by Student's prediction interval. *Flying straight* at the target is the "
        "floor, a planner that knows the map and tracks its shortest way is the ceiling, both on "
        "the same cases.",
        _verdict(report),
        "### Every seed",
        _seeds(report),
        "SPL is success weighted by path length, with the straight distance as the shortest; "
        "*SPL, ways* takes the shortest way around and over the obstacles instead, as the "
        "field's definition has it. Intervals are Wilson's, 95 %.",
        _figure(figures, FIGURE_8, "Figure 8: reward while training"),
        _reward_note(report),
        _figure(figures, FIGURE_6, "Figure 6: paths from above"),
        "## Moving targets",
        _moving(report),
        "The paper's random pre-defined trajectories: runs, circles and tours at a constant 0.5 "
        "to 2 m/s, 2 to 8 m a step of 4 s. The actors were trained on targets that rest, and see "
        "no velocity; the planner aims where the target will be after the step.",
        _figure(figures, FIGURE_5, "Figure 5: chase in free space"),
        *(
            _figure(figures, CHASES.format(map=name), f"Chase among the obstacles of {name}")
            for name in ("env1", "env2")
        ),
        "## The recipe",
        table(["What", "paper", "here"], [list(row) for row in report.recipe]),
        *coordinates_section(report, _figure(figures, COORDINATES, "Six coordinates: curves")),
        "## What transfer buys",
        _transfer(report),
        _figure(figures, TRANSFER, "Completion on validation cases over updates"),
        "## One change at a time",
        _ablations(report),
        _figure(figures, ABLATIONS, "Ablations on env1"),
        "## Errata",
        "Where the paper contradicts itself or is silent, with both values.",
        _errata(),
        _beta(report),
        "## How it was made",
        how_it_was_made(report),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def _banner(report: Report) -> str:
    lines = []
    if report.quick:
        lines.append(
            f"> **This is a quick run**, not the reproduction: {len(report.seeds)} training "
            f"seed{'s' if len(report.seeds) > 1 else ''}, {report.cases} test cases and a "
            f"fraction of the updates ({budget(report)}). It shows that everything works; its "
            "rates are lower, its intervals wider and its ablations rougher than those of the "
            "full run, and nothing is learnt from six coordinates alone. "
            "Run `training reproduce` without `--quick` for the numbers."
        )
    if report.unfinished:
        lines.append(
            f"> **Not finished**: {len(report.unfinished)} of "
            f"{len(report.unfinished) + len(report.runs)} runs, "
            f"{listed_by_seed(report.unfinished)}. Tables hold what is there; the same command "
            "goes on where it stopped."
        )
    return "\n>\n".join(lines)


def _departures(report: Report) -> str:
    state = next(ours for what, _, ours in report.recipe if what == "state")
    return (
        "The paper's: reward, exploration, horizon, batch, buffer, one critic, one-step targets, "
        f"transfer from the free stage. Not the paper's: the state is {state}; among obstacles an "
        "episode ends on contact, and by chance at any step; many worlds are stepped at once. The "
        "recipe and the ablations below say what exactly, and what each of them brings; the errata "
        "say what the paper leaves open or contradicts. So Table II is reached by the paper's "
        "algorithm, not from the paper's state." + coordinates_sentence(report)
    )


def _table_two(report: Report) -> str:
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


def _verdict(report: Report) -> str:
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


def _reward_note(report: Report) -> str:
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


def _seeds(report: Report) -> str:
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


def _moving(report: Report) -> str:
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


def _transfer(report: Report) -> str:
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
        verdict.append(
            "A likely cause is the critic, which has seen no obstacle: with a random one instead "
            f"the free actor comes to {averages[ACTOR_ONLY]:.1f} %, "
            f"{averages[ACTOR_ONLY] - averages[RECIPE]:+.1f} points against both, "
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


def _ablations(report: Report) -> str:
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


def _errata() -> str:
    return table(["#", "paper", "problem", "here"], [list(row) for row in ERRATA])


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


def _beta(report: Report) -> str:
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


def _main_runs(report: Report, map_name: str) -> list[RunResult]:
    return report.of("free" if map_name == "free" else "obstacles", map_name)


def _of_base(base: Baseline | None, which: str) -> str:
    if base is None:
        return "-"
    score: Score = getattr(base, which)
    return percent(score.evaluation.completion_rate)


def _figure(figures: Sequence[str], name: str, caption: str) -> str:
    return f"![{caption}]({name})" if name in figures else ""
