"""Numbers and tables of a report as text."""

from collections.abc import Iterable, Sequence

import numpy as np

PAPER_RATES = {"free": 1.00, "env1": 0.84, "env2": 0.82}
"""Table II."""


def percent(rate: float) -> str:
    """Return a rate for people."""
    return f"{100.0 * rate:.1f} %"


def spread(rates: Sequence[float]) -> str:
    """Return mean, least and largest of the rates of several seeds."""
    if not rates:
        return "not finished"
    if len(rates) == 1:
        return f"{percent(rates[0])} (one seed)"
    low, high = 100 * min(rates), 100 * max(rates)
    return f"**{percent(float(np.mean(rates)))}** ({low:.1f} - {high:.1f})"


def mean(rates: Sequence[float]) -> str:
    """Return the mean of rates."""
    return percent(float(np.mean(rates))) if rates else "-"


def minutes(seconds: float | None) -> str:
    """Return a duration for people."""
    if seconds is None:
        return "-"
    return f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.1f} min"


def listed(values: Iterable[object]) -> str:
    """Return values as a list in a sentence."""
    return ", ".join(str(value) for value in values)


def table(heading: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    lines = [heading, ["---"] * len(heading), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
