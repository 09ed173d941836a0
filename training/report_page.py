"""The report's page: tables out of ``numbers.json``, with the figures between them."""

from collections.abc import Sequence

from training.report_comparisons import (
    one_change_at_a_time,
    two_readings_of_beta,
    what_transfer_buys,
)
from training.report_coordinates import coordinates_section, coordinates_sentence
from training.report_data import Report
from training.report_errata import ERRATA
from training.report_made import budget, how_it_was_made
from training.report_results import every_seed, moving_targets, reward_note, table_two, verdict
from training.report_words import listed, listed_by_seed, table

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
        table_two(report),
        "Rates are shares of the test cases that came within 5 m of the target without touching "
        "an obstacle before, policy alone, no shield. *Mean (min - max)* is over training seeds "
        f"{listed(report.seeds)}: no seed was left out; *one more seed* is where another is to be "
        "expected, by Student's prediction interval. *Flying straight* at the target is the "
        "floor, a planner that knows the map and tracks its shortest way is the ceiling, both on "
        "the same cases.",
        verdict(report),
        "### Every seed",
        every_seed(report),
        "SPL is success weighted by path length, with the straight distance as the shortest; "
        "*SPL, ways* takes the shortest way around and over the obstacles instead, as the "
        "field's definition has it. Intervals are Wilson's, 95 %.",
        _figure(figures, FIGURE_8, "Figure 8: reward while training"),
        reward_note(report),
        _figure(figures, FIGURE_6, "Figure 6: paths from above"),
        "## Moving targets",
        moving_targets(report),
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
        what_transfer_buys(report),
        _figure(figures, TRANSFER, "Completion on validation cases over updates"),
        "## One change at a time",
        one_change_at_a_time(report),
        _figure(figures, ABLATIONS, "Ablations on env1"),
        "## Errata",
        "Where the paper contradicts itself or is silent, with both values.",
        _errata(),
        two_readings_of_beta(report),
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


def _errata() -> str:
    return table(["#", "paper", "problem", "here"], [list(row) for row in ERRATA])


def _figure(figures: Sequence[str], name: str, caption: str) -> str:
    return f"![{caption}]({name})" if name in figures else ""
