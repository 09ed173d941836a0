"""Numbers and tables of a report as text."""

from collections.abc import Iterable, Sequence

import numpy as np

PAPER_RATES = {"free": 1.00, "env1": 0.84, "env2": 0.82}
"""Table II."""
_STUDENT_T = (12.71, 4.30, 3.18, 2.78, 2.57, 2.45, 2.36, 2.31, 2.26)
"""Quantile 0.975 for 1 to 9 degrees of freedom."""


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


def another_seed(rates: Sequence[float]) -> str:
    """Return where one more seed is to be expected: the 95 % prediction interval.

    Student's: mean +- t s sqrt(1 + 1 / n), cut at 0 and 100 %.
    """
    count = len(rates)
    if count < 2 or count - 2 >= len(_STUDENT_T):
        return "-"
    reach = _STUDENT_T[count - 2] * float(np.std(rates, ddof=1)) * (1.0 + 1.0 / count) ** 0.5
    average = float(np.mean(rates))
    low, high = max(average - reach, 0.0), min(average + reach, 1.0)
    return f"{100 * low:.1f} - {100 * high:.1f}"


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


def listed_by_seed(names: Iterable[str]) -> str:
    """Return names that end in ``-seedN`` as a list, seeds of one name together."""
    seeds: dict[str, list[str]] = {}
    for name in names:
        run, _, seed = name.rpartition("-seed")
        seeds.setdefault(run, []).append(seed)
    return listed(f"{run} (seed {listed(found)})" for run, found in seeds.items())


def table(heading: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    lines = [heading, ["---"] * len(heading), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
