"""Learning curves and bars: Figure 8, transfer against scratch, ablations."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FuncFormatter, PercentFormatter

from training.curves import Curve, band, smoothed
from training.figure_style import (
    BLACK,
    BLUE,
    GREEN,
    ORANGE,
    RED,
    SEED_COLOURS,
    SKY,
    new_figure,
    save,
)

_BAND = "band from worst to best"
_THOUSANDS = FuncFormatter(lambda value, _: f"{value / 1000:g}")


@dataclass(frozen=True, slots=True)
class Level:
    """A horizontal line to compare with."""

    value: float
    label: str


@dataclass(frozen=True, slots=True)
class Bar:
    """One row of the ablations."""

    label: str
    rates: tuple[float, ...]
    """Of every seed."""
    interval: tuple[float, float]
    """Wilson's, where there is one seed; else the least and the largest rate."""


def draw_rewards(
    panels: Mapping[str, Mapping[str, Curve]],
    levels: Mapping[str, Sequence[Level]],
    path: Path,
    heading: str,
) -> Path:
    """Draw the reward of 100 steps over the steps trained, a line a run: Figure 8.

    Args:
        panels: By title; in each the runs by label, a ``Curve`` over hundreds of steps.
        levels: By the same titles.
        path: PNG to write.
        heading: Above all panels.
    """
    figure, axes_row = new_figure(
        len(panels), width_in=5.4 * len(panels), height_in=4.8, heading=heading
    )
    for axes, (title, runs) in zip(axes_row, panels.items(), strict=True):
        axes.set_title(title)
        axes.set_xlabel("steps of all worlds (hundred thousands)")
        axes.set_ylabel("reward in 100 steps")
        axes.xaxis.set_major_formatter(_THOUSANDS)
        for colour, (label, curve) in zip(SEED_COLOURS, runs.items(), strict=False):
            axes.plot(curve.updates, curve.value, color=colour, alpha=0.25, linewidth=0.8)
            mean = smoothed(curve, max(3, len(curve.value) // 25))
            axes.plot(mean.updates, mean.value, color=colour, linewidth=2.0, label=label)
        _draw_levels(axes, levels.get(title, ()))
        axes.legend(loc="lower right")
    return save(figure, path)


def draw_completion(
    groups: Mapping[str, Sequence[Curve]], levels: Sequence[Level], path: Path, heading: str
) -> Path:
    """Draw completion on validation over updates: mean of the seeds within their extremes.

    Args:
        groups: By label; one curve a seed.
        levels: Rates to compare with.
        path: PNG to write.
        heading: Above the panel.
    """
    figure, (axes,) = new_figure(1, width_in=8.2, height_in=5.2, heading=heading)
    for colour, marker, (label, curves) in zip(
        (BLUE, ORANGE, GREEN), "osD", groups.items(), strict=False
    ):
        span = band(curves)
        axes.fill_between(span.updates, span.low, span.high, color=colour, alpha=0.22, linewidth=0)
        axes.plot(
            span.updates,
            span.mean,
            color=colour,
            linewidth=2.2,
            marker=marker,
            markevery=20,
            label=label if span.seeds == 1 else f"{label}: mean of {span.seeds} seeds, {_BAND}",
        )
    _draw_levels(axes, levels)
    axes.set_xlabel("updates of the networks (thousands)")
    axes.set_ylabel("completed validation cases")
    axes.xaxis.set_major_formatter(_THOUSANDS)
    axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    axes.set_ylim(0.0, 1.0)
    axes.legend(loc="upper left", bbox_to_anchor=(0.0, -0.14), frameon=False)
    return save(figure, path)


def draw_ablations(bars: Sequence[Bar], levels: Sequence[Level], path: Path, heading: str) -> Path:
    """Draw a bar for each change, the first one the recipe as it is."""
    figure, (axes,) = new_figure(1, width_in=9.5, height_in=1.9 + 0.42 * len(bars), heading=heading)
    places = np.arange(len(bars))[::-1]
    means = np.array([float(np.mean(bar.rates)) for bar in bars])
    colours = [BLUE] + [SKY] * (len(bars) - 1)
    axes.barh(places, means, color=colours, height=0.62, zorder=2)
    for place, mean, bar in zip(places, means, bars, strict=True):
        low, high = bar.interval
        axes.errorbar(
            mean,
            place,
            xerr=[[max(mean - low, 0.0)], [max(high - mean, 0.0)]],
            color=BLACK,
            capsize=4,
            linewidth=1.4,
            zorder=3,
        )
        axes.plot(
            bar.rates,
            [place] * len(bar.rates),
            "o",
            color=ORANGE,
            markersize=5,
            markeredgecolor=BLACK,
            zorder=4,
        )
        axes.text(
            max(high, *bar.rates) + 0.015,
            place,
            f"{100 * mean:.1f} %",
            va="center",
            fontsize=10,
            path_effects=[withStroke(linewidth=3.0, foreground="white")],
            zorder=5,
        )
    axes.set_yticks(places, [bar.label for bar in bars])
    axes.tick_params(axis="y", length=0)
    axes.grid(visible=False, axis="y")
    _draw_levels(axes, levels, upright=True)
    axes.set_xlim(0.0, 1.08)
    axes.set_ylim(-0.6, len(bars) - 0.4)
    axes.xaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    axes.set_xlabel("completed test cases (dots: seeds; whiskers: worst to best, or Wilson's 95 %)")
    if levels:
        axes.figure.legend(loc="outside lower center", ncols=len(levels), frameon=False)
    return save(figure, path)


def _draw_levels(axes: Axes, levels: Sequence[Level], *, upright: bool = False) -> None:
    for colour, style, level in zip((BLACK, RED, GREEN), ("--", ":", "-."), levels, strict=False):
        draw = axes.axvline if upright else axes.axhline
        draw(level.value, color=colour, linestyle=style, linewidth=1.5, label=level.label, zorder=1)
