"""How figures look: one palette that colour-blind people can read, one size of letters."""

from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

# Okabe and Ito's palette.
BLUE = "#0072B2"
ORANGE = "#E69F00"
GREEN = "#009E73"
RED = "#D55E00"
PURPLE = "#CC79A7"
SKY = "#56B4E9"
YELLOW = "#F0E442"
BLACK = "#000000"
GREY = "#7F7F7F"
OBSTACLE = "#D0D0D0"
SEED_COLOURS = (BLUE, ORANGE, GREEN, PURPLE, SKY, RED)

_DPI = 110
_STYLE: dict[Any, Any] = {
    "font.size": 11,
    "axes.titlesize": 12,
    "axes.labelsize": 11,
    "legend.fontsize": 10,
    "xtick.labelsize": 10,
    "ytick.labelsize": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#E4E4E4",
    "axes.axisbelow": True,
}


def new_figure(
    columns: int, *, width_in: float, height_in: float, heading: str
) -> tuple[Figure, list[Axes]]:
    """Return a figure with one row of panels."""
    with rc_context(_STYLE):
        figure = Figure(figsize=(width_in, height_in), layout="constrained")
        axes = figure.subplots(1, columns, squeeze=False)
        figure.suptitle(heading, fontsize=13)
    return figure, list(axes[0])


def save(figure: Figure, path: Path) -> Path:
    """Write the PNG; it holds no date and no version, so that equal figures are equal files."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with rc_context(_STYLE):
        figure.savefig(path, dpi=_DPI, metadata={"Software": None})
    return path
