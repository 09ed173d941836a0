"""A picture of a recording, by a viewer without a window.

Needs a Vulkan driver; on a machine without a graphics card that is Mesa's lavapipe, Debian's
``mesa-vulkan-drivers`` and ``libvulkan1``.
"""

from collections.abc import Sequence
from pathlib import Path

from rerun.experimental import ViewerClient

from companion.clock import now_s, sleep_s
from companion.errors import CompanionError
from companion.session.viewer import headless_viewer

_LOAD_S = 120.0
_TOAST_S = 5.0  # until the viewer's own notices have faded
_SETTLE_S = 1.5  # after a jump in time
_STILL_S = 0.5  # loading shows as moving dots
_TIMELINE = "session"


def render(
    recordings: Sequence[Path],
    png: Path,
    *,
    at_s: float | None,
    size: tuple[int, int],
    views: Sequence[str] = (),
) -> None:
    """Render ``recordings`` at ``at_s``, or at the end, into ``png``.

    Args:
        recordings: What to open: one recording, and layers over it.
        png: The picture; overwritten.
        at_s: Time since the start.
        size: Of the window, pixels.
        views: Only the first view that has one of these names.

    Raises:
        UsageError: If Rerun is not installed.
        CompanionError: If the viewer cannot start here, or cannot read the recording.
    """
    with headless_viewer(size) as address:
        client = ViewerClient.connect(address)
        end_s = _load(client, recordings)
        sleep_s(_TOAST_S)
        time_s = end_s if at_s is None else min(max(0.0, at_s), end_s)
        client.set_time(_TIMELINE, duration=time_s, play_state="paused")
        sleep_s(_SETTLE_S)
        shoot_settled(client, png.resolve(), _view_id(client, views))


def shoot_settled(client: ViewerClient, png: Path, view_id: str | None = None) -> None:
    """Save the picture once it has stopped changing: long recordings are drawn bit by bit."""
    deadline_s = now_s() + _LOAD_S
    before = b""
    while now_s() < deadline_s:
        client.save_screenshot(str(png), view_id)
        picture = png.read_bytes()
        if picture == before:
            return
        before = picture
        sleep_s(_STILL_S)


def _view_id(client: ViewerClient, names: Sequence[str]) -> str | None:
    """Return the id of a view by its name; ``None``, the whole window, if there is none."""
    for view in client.get_state().views if names else ():
        if view.name in names:
            return view.view_id
    return None


def _load(client: ViewerClient, recordings: Sequence[Path]) -> float:
    """Load the recordings and return where their timeline ends, in seconds."""
    deadline_s = now_s() + _LOAD_S
    client.open([str(recording) for recording in recordings])
    while client.get_state().loading:
        if now_s() > deadline_s:
            raise CompanionError(f"the viewer did not load {recordings[0]} in {_LOAD_S:.0f} s")
        sleep_s(0.1)
    for found in client.get_state().recordings:
        for timeline in found.timelines:
            if timeline.name == _TIMELINE and timeline.end is not None:
                return timeline.end / 1e9
    raise CompanionError(f"{recordings[0]} holds nothing to show")
