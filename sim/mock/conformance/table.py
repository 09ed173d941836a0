"""The table of a comparison."""

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Row:
    """One thing compared."""

    what: str
    recorded: str
    mock: str
    deviation: float
    """In the unit of the limit; infinite where nothing fits at all."""
    limit: float
    unit: str
    where: str = ""
    """Where the deviation is largest, in words."""

    @property
    def holds(self) -> bool:
        """Whether the mock agrees."""
        return self.deviation <= self.limit


def as_text(title: str, rows: list[Row]) -> str:
    """Return the rows as lines of text."""
    cells = [("", "what", "recorded", "mock", "deviation", "limit", "")]
    for row in rows:
        deviation = "-" if math.isinf(row.deviation) else f"{row.deviation:.3g} {row.unit}"
        limit = f"{row.limit:.3g} {row.unit}"
        mark = "ok" if row.holds else "NO"
        cells.append((mark, row.what, row.recorded, row.mock, deviation, limit, row.where))
    widths = [max(len(line[column]) for line in cells) for column in range(7)]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
             for line in cells]  # fmt: skip
    held = sum(row.holds for row in rows)
    return "\n".join([f"{title}: {held} of {len(rows)} agree", *lines, ""])
