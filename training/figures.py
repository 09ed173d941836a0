"""All figures of a report, drawn from its numbers and curves."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from training import report_page as page
from training.curves import Curve
from training.evaluate import wilson_interval
from training.figure_curves import Bar, Level, draw_ablations, draw_completion, draw_rewards
from training.figure_paths import draw_chase, draw_paths
from training.report_comparisons import STARTS
from training.report_data import Drawn, Points, Report, RunResult
from training.report_results import TITLES
from training.report_words import PAPER_RATES
from training.reproduce_plan import ABLATION_MAP, OBSTACLE_MAPS


def draw_all(report: Report, drawn: Drawn, folder: Path) -> list[str]:
    """Draw every figure for which there is something to draw and return the file names."""
    mark = " (quick run)" if report.quick else ""
    paths = [
        _rewards(report, drawn, folder / page.FIGURE_8, mark),
        _transfer(report, drawn, folder / page.TRANSFER, mark),
        _ablations(report, folder / page.ABLATIONS, mark),
        _coordinates(report, drawn, folder / page.COORDINATES, mark),
    ]
    if drawn.paths:
        heading = f"Figure 6: paths of the trained actors{mark}"
        paths.append(draw_paths(drawn.paths, folder / page.FIGURE_6, heading))
    for scene in drawn.chases:
        name = page.FIGURE_5 if scene.map == "free" else page.CHASES.format(map=scene.map)
        number = "Figure 5: " if scene.map == "free" else ""
        heading = f"{number}chase of a moving target, {TITLES[scene.map]}{mark}"
        paths.append(draw_chase(scene, folder / name, heading))
    return [path.name for path in paths if path is not None]


def _rewards(report: Report, drawn: Drawn, path: Path, mark: str) -> Path | None:
    panels: dict[str, dict[str, Curve]] = {}
    levels: dict[str, list[Level]] = {}
    for letter, map_name in zip("abc", PAPER_RATES, strict=True):
        runs = report.of("free" if map_name == "free" else "obstacles", map_name)
        if not runs:
            continue
        title = f"({letter}) {TITLES[map_name]}"
        panels[title] = {f"seed {run.seed}": _curve(drawn.curves[run.name].rewards) for run in runs}
        base = report.baseline(map_name)
        if base is not None:
            levels[title] = [
                Level(base.planner.mean_return, "planner, from start to step 100"),
                Level(base.straight.mean_return, "flying straight, likewise"),
            ]
    if not panels:
        return None
    heading = f"Figure 8: reward in training, exploration included{mark}"
    return draw_rewards(panels, levels, path, heading)


def _transfer(report: Report, drawn: Drawn, path: Path, mark: str) -> Path | None:
    groups: dict[str, list[Curve]] = {}
    for variant, label in STARTS.items():
        curves = [
            _curve(drawn.curves[run.name].validation)
            for run in report.of("ablation", ABLATION_MAP, variant)
        ]
        if curves:
            groups[label] = curves
    if not groups:
        return None
    heading = f"{ABLATION_MAP}: what transfer buys{mark}"
    return draw_completion(groups, _rates(report), path, heading)


def _coordinates(report: Report, drawn: Drawn, path: Path, mark: str) -> Path | None:
    groups = {
        map_name: [_curve(drawn.curves[run.name].validation) for run in runs]
        for map_name in OBSTACLE_MAPS
        if (runs := report.of("coordinates", map_name))
    }
    if not groups:
        return None
    levels = [
        Level(PAPER_RATES[name], f"the paper's {100 * PAPER_RATES[name]:.0f} % of {name}")
        for name in groups
    ]
    heading = f"From the paper's six coordinates alone{mark}"
    return draw_completion(groups, levels, path, heading)


def _ablations(report: Report, path: Path, mark: str) -> Path | None:
    bars = []
    for change in report.changes:
        runs = report.of("ablation", ABLATION_MAP, change.name)
        if runs:
            bars.append(_bar(change.name, runs, report.cases))
    if len(bars) < 2:
        return None
    heading = f"{ABLATION_MAP}: one change at a time, {report.updates['ablation']:,} updates{mark}"
    return draw_ablations(bars, _rates(report), path, heading)


def _bar(label: str, runs: Sequence[RunResult], cases: int) -> Bar:
    rates = tuple(run.static.evaluation.completion_rate for run in runs)
    interval = (min(rates), max(rates))
    if len(rates) == 1:
        interval = wilson_interval(rates[0], cases)
    return Bar(label, rates, interval)


def _rates(report: Report) -> list[Level]:
    paper = PAPER_RATES[ABLATION_MAP]
    levels = [Level(paper, f"the paper's {100 * paper:.0f} %, after 4 million updates")]
    base = report.baseline(ABLATION_MAP)
    if base is not None:
        levels.append(Level(base.straight.evaluation.completion_rate, "flying straight"))
    return levels


def _curve(points: Points) -> Curve:
    table = np.array(points, dtype=np.float64).reshape(-1, 2)
    return Curve(table[:, 0], table[:, 1])
