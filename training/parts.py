"""Cases cut into parts, each flown at once and with random numbers of its own.

What comes of a part depends on its number and the seed alone: not on what else is flown, nor on
how many processes share the work. Ways take room for each case, so a part is also what fits.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from companion.world.maps import Map

PART_CASES = 125
"""Cases of a part, at most."""


@dataclass(frozen=True, slots=True)
class Part:
    """Some of the cases, on some of the maps; the cases are spread evenly over these."""

    number: int
    maps: tuple[Map, ...]
    episodes: int


def parts_of(maps: Sequence[Map], episodes: int) -> list[Part]:
    """Return all cases in parts: several maps with all of their cases, or some cases of one map.

    Args:
        maps: Over which the cases are spread evenly.
        episodes: How many cases.

    Raises:
        ValueError: If there are fewer cases than maps.
    """
    if episodes < len(maps):
        raise ValueError(f"need a case for each of {len(maps)} maps, got {episodes}")
    ends = [-(-(number + 1) * episodes // len(maps)) for number in range(len(maps))]
    counts = [end - begin for begin, end in zip([0, *ends], ends, strict=False)]
    pieces: list[tuple[list[Map], int]] = []
    room = 0
    for city, count in zip(maps, counts, strict=True):
        if count <= room:
            cities, others = pieces[-1]
            pieces[-1] = ([*cities, city], others + count)
            room -= count
            continue
        num_pieces = max(1, -(-count // PART_CASES))
        shares = [
            count * (n + 1) // num_pieces - count * n // num_pieces for n in range(num_pieces)
        ]
        pieces += [([city], share) for share in shares]
        room = PART_CASES - count if num_pieces == 1 else 0
    return [Part(n, tuple(cities), count) for n, (cities, count) in enumerate(pieces)]
