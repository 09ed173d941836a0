"""Shows a flight in the viewer, or renders it into a picture."""

import shlex
import tempfile
from collections.abc import Sequence
from pathlib import Path

from companion.errors import UsageError
from companion.review.recordings import make_recordings
from companion.session import viewer
from companion.session.flight import Flight
from companion.session.records import map_record
from companion.world.maps import Map

LARGE = (1920, 1080)


def open_viewer(flight: Flight) -> str:
    """Open the flight in a viewer of its own and return what was done, a line or two.

    Without a display nothing is opened, and the line says how to open the recording elsewhere.

    Raises:
        UsageError: If there is nothing to open, or Rerun is not installed.
    """
    recordings = make_recordings(flight, Path(tempfile.mkdtemp(prefix="companion-review-")))
    if not viewer.has_display():
        return (
            "no display here: copy the recording to a desk and open it there with\n"
            f"  rerun {shlex.join(map(str, recordings))}"
        )
    viewer.open_viewer(*map(str, recordings))
    return f"opened {recordings[0]}"


def render_png(
    flight: Flight,
    png: Path,
    *,
    at_s: float | None = None,
    size: tuple[int, int] = LARGE,
    views: Sequence[str] = (),
) -> None:
    """Render the flight into a picture, without a display.

    Args:
        flight: What to show.
        png: The picture; overwritten.
        at_s: Time of the picture since the start; the end, if not given.
        size: Width and height in pixels.
        views: Only the first view that has one of these names.

    Raises:
        UsageError: If there is nothing to show, or Rerun is not installed.
        CompanionError: If the viewer cannot start here.
    """
    if not png.absolute().parent.is_dir():
        raise UsageError(f"cannot write {png}: there is no folder {png.parent}")
    with tempfile.TemporaryDirectory(prefix="companion-review-") as folder:
        recordings = make_recordings(flight, Path(folder))
        from companion.session.picture import render

        render(recordings, png, at_s=at_s, size=size, views=views)


def show_map(city: Map) -> str:
    """Open a map in the viewer and return what was done.

    Raises:
        UsageError: If there is no display, or Rerun is not installed.
    """
    if not viewer.has_display():
        raise UsageError("there is no display here to show the map on")
    viewer.viewer_binary()
    from companion.session.streams import write_map

    recording = Path(tempfile.mkdtemp(prefix="companion-map-")) / f"{city.name}.rrd"
    write_map(recording, map_record(city))
    viewer.open_viewer(str(recording))
    return f"opened {recording}"
