"""``companion review``: what to print, open and write."""

import tempfile
from collections.abc import Sequence
from pathlib import Path

from companion.review import compare, show
from companion.review.sources import open_flight
from companion.review.words import report


def review_command(
    paths: Sequence[Path],
    *,
    text: bool,
    png: Path | None,
    at_s: float | None,
    html: Path | None,
    map_name: str | None,
) -> int:
    """Review one flight, or two beside each other, and return the exit code.

    Raises:
        CompanionError: If a flight cannot be read, or a picture or page not be written.
    """
    if len(paths) == 2:
        return _compare(paths, text=text, png=png, at_s=at_s, html=html, map_name=map_name)
    flight = open_flight(paths[0], map_name)
    print(report(flight))
    print()
    if png is not None:
        show.render_png(flight, png, at_s=at_s)
        print(f"wrote {png}")
    if html is not None:
        from companion.review.page import write_page

        print(f"wrote {write_page(flight, html, at_s=at_s)}")
    if png is None and html is None and not text:
        print(show.open_viewer(flight))
    return 0


def _compare(
    paths: Sequence[Path],
    *,
    text: bool,
    png: Path | None,
    at_s: float | None,
    html: Path | None,
    map_name: str | None,
) -> int:
    both = compare.pair(*(open_flight(path, map_name) for path in paths))
    print(compare.words(both))
    print()
    from companion.review import pair_show

    if png is not None:
        with tempfile.TemporaryDirectory(prefix="companion-compare-") as folder:
            show.render_png(pair_show.recorded(both, Path(folder)), png, at_s=at_s)
        print(f"wrote {png}")
    if html is not None:
        print(f"wrote {pair_show.write_pair_page(both, html, at_s=at_s)}")
    if png is None and html is None and not text:
        print(pair_show.open_pair(both))
    return 0
