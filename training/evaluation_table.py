"""Evaluations side by side, for people."""

from collections.abc import Mapping
from dataclasses import dataclass

from training.evaluate import Evaluation

_LABEL = 20


@dataclass(frozen=True, slots=True)
class Flown:
    """What came of one policy on one set of cases."""

    alone: Evaluation
    with_shield: Evaluation | None


def evaluation_table(title: str, rows: Mapping[str, Flown]) -> str:
    """Return two lines of headings, then a line for each row and one for it with the shield.

    At most 80 columns wide, without a final newline. Done, collided and late are shares of all
    cases in percent, the first with its 95 % Wilson interval; so are those that came within 2 m
    and 1 m. Clear is the distance to obstacles that all flights but 1 % kept.
    """
    lines = [
        f"{_label(title)}{'done':>6}{'95 %':>12}{'collided':>10}{'late':>6}"
        f"{'2 m':>7}{'1 m':>7}{'SPL':>6}{'clear':>6}",
        f"{_label('')}{'%':>6}{'':>12}{'%':>10}{'%':>6}{'%':>7}{'%':>7}{'':>6}{'m':>6}",
    ]
    for label, flown in rows.items():
        lines.append(_line(label, flown.alone))
        if flown.with_shield is not None:
            lines.append(_line("  with shield", flown.with_shield))
    return "\n".join(lines)


def _line(label: str, row: Evaluation) -> str:
    low, high = row.completion_rate_ci95
    clear = "-" if row.min_clearance_m is None else f"{row.min_clearance_m['p1']:.1f}"
    return (
        f"{_label(label)}{100 * row.completion_rate:>6.1f}"
        f"{f'{100 * low:.1f}-{100 * high:.1f}':>12}{100 * row.collision_rate:>10.1f}"
        f"{100 * row.timeout_rate:>6.1f}{100 * row.completion_2m:>7.1f}"
        f"{100 * row.completion_1m:>7.1f}{row.spl:>6.2f}{clear:>6}"
    )


def _label(text: str) -> str:
    return f"{text if len(text) < _LABEL else text[: _LABEL - 4] + '...':<{_LABEL}}"
