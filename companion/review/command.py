"""``companion review``: what to print, open and write."""

from collections.abc import Sequence
from pathlib import Path

from companion.review import show
from companion.review.sources import open_flight
from companion.review.words import report


def review_command(
    paths: Sequence[Path],
    *,
    text: bool,
    png: Path | None,
    at_s: float | None,
    html: Path | None,
) -> int:
    """Review one flight, or two beside each other, and return the exit code.

    Raises:
        CompanionError: If a flight cannot be read, or a picture or page not be written.
    """
    flight = open_flight(paths[0])
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
