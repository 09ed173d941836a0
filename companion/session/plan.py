"""The plan: the map from above without perspective, in which tall obstacles hide nothing.

Coordinates are metres east and south: the viewer's second axis points down the screen.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np
import rerun as rr

from companion.arrays import FloatArray
from companion.session import colors, motion
from companion.session.colors import Color
from companion.session.records import SessionStart, Tick
from companion.session.writer import StreamWriter

_GRID_LINES = 10  # to the longer side


class Plan:
    """Logs the plan: the map once, vehicle, target and paths a batch of ticks at a time."""

    def __init__(self, writer: StreamWriter, start: SessionStart) -> None:
        """Draw the map."""
        self._writer = writer
        self._paint = motion.painter(start)
        if start.actor.name:  # the 3-D view tells who decided
            self._paint = partial(motion.clearance_color, margin_m=start.margin_m)
        self._paths = {"vehicle": motion.Path(), "target": motion.Path()}
        city = start.map
        east_m, north_m, _ = city.size_m
        spacing_m = max(east_m, north_m) / _GRID_LINES
        lines = [[[x, 0.0], [x, north_m]] for x in np.arange(0.0, east_m + 1e-6, spacing_m)]
        lines += [[[0.0, y], [east_m, y]] for y in np.arange(0.0, north_m + 1e-6, spacing_m)]
        writer.static(
            "plan/map/grid", _strips([np.array(line) for line in lines], colors.GRID, 0.5)
        )
        rings = [np.array([*ring, ring[0]], dtype=float) for ring in city.footprints_m]
        heights = [f"{height_m:g} m" for height_m in city.heights_m]
        writer.static("plan/map/obstacles", _strips(rings, colors.LIMIT, 1.5, heights))
        dot = rr.Points2D.from_fields(colors=[colors.BODY], radii=rr.Radius.ui_points(5.0))
        writer.static("plan/vehicle", dot)
        disc = rr.Points2D.from_fields(colors=[(*colors.TARGET, 140)], radii=start.arrival_radius_m)
        writer.static("plan/target", disc)

    def send(self, ticks: Sequence[Tick]) -> None:
        """Send one batch."""
        placed = [tick for tick in ticks if tick.position_enu_m is not None]
        self._send_place("vehicle", [(tick.time_s, tick.position_enu_m) for tick in placed])
        self._send_path(
            "vehicle",
            [(tick.time_s, tick.position_enu_m, self._paint(tick)) for tick in placed],
        )
        targeted = [tick for tick in ticks if tick.target_enu_m is not None]
        self._send_place("target", [(tick.time_s, tick.target_enu_m) for tick in targeted])
        self._send_path(
            "target", [(tick.time_s, tick.target_enu_m, colors.TARGET) for tick in targeted]
        )

    def finish(self) -> None:
        """Send the ends of the paths."""
        for name, path in self._paths.items():
            self._send_pieces(name, [path.finish()])

    def _send_place(self, name: str, places: Sequence[tuple[float, list[float] | None]]) -> None:
        if places:
            positions = _on_plan(motion.vectors([position_m for _, position_m in places]))
            columns = rr.Points2D.columns(positions=positions)
            self._writer.columns(f"plan/{name}", [time_s for time_s, _ in places], columns)

    def _send_path(
        self, name: str, steps: Sequence[tuple[float, list[float] | None, Color]]
    ) -> None:
        path = self._paths[name]
        self._send_pieces(
            name, [path.extend(time_s, at_m, color) for time_s, at_m, color in steps if at_m]
        )

    def _send_pieces(self, name: str, found: Sequence[motion.Piece | None]) -> None:
        pieces = [piece for piece in found if piece is not None]
        if pieces:
            columns = rr.LineStrips2D.columns(
                strips=[_on_plan(motion.vectors(piece.points_m)) for piece in pieces],
                colors=np.array([colors.packed(piece.color) for piece in pieces], np.uint32),
            )
            times_s = [piece.time_s for piece in pieces]
            self._writer.columns(f"plan/path/{name}", times_s, columns)


def _on_plan(positions_m: FloatArray) -> FloatArray:
    """Turn positions ``(..., 2 or 3)``, east and north first, into places on the plan."""
    return positions_m[..., :2] * [1.0, -1.0]


def _strips(
    strips: Sequence[FloatArray], color: Color, width: float, labels: Sequence[str] | None = None
) -> rr.LineStrips2D:
    return rr.LineStrips2D(
        [_on_plan(strip) for strip in strips],
        colors=[color],
        radii=rr.Radius.ui_points(width),
        labels=labels,
        show_labels=labels is not None,
    )
