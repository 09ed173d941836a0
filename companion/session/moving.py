"""Ticks into what moves in the 3-D view: vehicle, target, arrows, paths, the chase camera."""

from collections.abc import Callable, Sequence

import numpy as np
import rerun as rr

from companion.arrays import FloatArray
from companion.session import colors, motion, scene
from companion.session.colors import Color
from companion.session.records import SessionStart, Tick
from companion.session.senses import Senses
from companion.session.target_view import TargetView
from companion.session.writer import StreamWriter
from companion.world.geometry import Obstacles

_ARROW_S = 1.5  # an arrow ends where the vehicle would be by then
_LOOK_S = 0.2  # between two drawings of what the actor saw
_NEAR_MARGINS = 5.0  # obstacles farther away than this many margins are not pointed at
_ARROWS: dict[str, tuple[Color, float, Callable[[Tick], list[float] | None]]] = {
    "proposed": (colors.PROPOSED, 0.0035, lambda tick: tick.proposed_enu_mps),
    "sent": (colors.SENT, 0.0028, lambda tick: tick.safe_enu_mps),
    "measured": (colors.MEASURED, 0.0020, lambda tick: tick.velocity_enu_mps),
}
"""Colour, radius as a fraction of the map, velocity; thinner ones lie inside thicker ones."""


class Moving:
    """Logs what moves, a batch of ticks at a time."""

    def __init__(self, writer: StreamWriter, start: SessionStart) -> None:
        """Colour the arrows and the plumb line."""
        self._writer = writer
        self._start = start
        self._edge_m = max(start.map.size_m[:2])
        self._course = motion.Course()
        self._paths = {"vehicle": motion.Path(), "target": motion.Path()}
        self._paint = motion.painter(start)
        self._shown: set[str] = set()
        for name, (color, radius, _) in _ARROWS.items():
            style = rr.Arrows3D.from_fields(colors=[color], radii=[radius * self._edge_m])
            writer.static(f"world/velocity/{name}", style)
        writer.static("world/plumb", scene.line_style(colors.LIMIT, 1.0))
        writer.static("world/nearest", scene.line_style(colors.SHIELDED, 1.5))
        margin = rr.LineStrips3D(
            [scene.circle(start.margin_m)],
            colors=[(*colors.DANGER, 150)],
            radii=rr.Radius.ui_points(1.0),
        )
        if start.margin_m:
            writer.static("world/chase/margin", margin)
        writer.static("world/seen/rays", scene.line_style((*colors.EXTRA, 110), 0.8))
        writer.static("world/seen/way", scene.line_style(colors.EXTRA, 2.0))
        self._senses = Senses(start.actor.layout, start.actor.columns)
        self._look_due_s = 0.0
        self._looks: list[tuple[float, FloatArray, FloatArray]] = []
        self._target = TargetView(writer, start)
        footprints_m = [np.array(ring) for ring in start.map.footprints_m]
        self._obstacles = Obstacles(footprints_m, start.map.heights_m)

    def send(self, ticks: Sequence[Tick]) -> None:
        """Send one batch."""
        placed = [tick for tick in ticks if tick.position_enu_m is not None]
        if placed:
            self._send_vehicle(placed)
        targeted = [tick for tick in ticks if tick.target_enu_m is not None]
        if targeted:
            self._target.send(targeted)
            self._send_path(
                "target", [(tick, tick.target_enu_m, colors.TARGET) for tick in targeted]
            )

    def finish(self) -> None:
        """Send the ends of the paths."""
        for name, path in self._paths.items():
            self._send_pieces(name, [path.finish()])

    def _send_vehicle(self, ticks: Sequence[Tick]) -> None:
        if "vehicle" not in self._shown:
            self._shown.add("vehicle")
            for name, shape in scene.vehicle_shapes(self._edge_m).items():
                self._writer.at(ticks[0].time_s, f"world/vehicle/{name}", shape)
        times_s = [tick.time_s for tick in ticks]
        position_m = motion.vectors([tick.position_enu_m for tick in ticks])
        attitude_rad = motion.vectors([tick.attitude_rad or [0.0, 0.0, 0.0] for tick in ticks])
        course_rad = np.array([self._course.update(tick) for tick in ticks])
        for path, quaternion in (
            ("world/vehicle", motion.attitude_enu(attitude_rad)),
            ("world/chase", motion.yaw_enu(course_rad)),
        ):
            pose = rr.Transform3D.columns(translation=position_m, quaternion=quaternion)
            self._writer.columns(path, times_s, pose)
        self._send_distances(times_s, position_m)
        if self._senses.sees:
            self._send_senses(ticks)
        for name, (_, _, velocity) in _ARROWS.items():
            self._send_arrows(f"world/velocity/{name}", ticks, velocity)
        self._send_path(
            "vehicle", [(tick, tick.position_enu_m, self._paint(tick)) for tick in ticks]
        )

    def _send_distances(self, times_s: Sequence[float], position_m: FloatArray) -> None:
        """Send the line down to ground or roof, and the one to the nearest obstacle if near."""
        below_m = np.column_stack((position_m[:, :2], self._obstacles.floor_m(position_m)))
        plumb_m = np.stack((position_m, below_m), axis=1)
        self._writer.columns("world/plumb", times_s, rr.LineStrips3D.columns(strips=list(plumb_m)))
        surface_m = self._obstacles.nearest_surface(position_m)
        near = (
            np.linalg.norm(surface_m - position_m, axis=-1) < _NEAR_MARGINS * self._start.margin_m
        )
        lines_m = np.stack((position_m, surface_m), axis=1)[near]
        columns = rr.LineStrips3D.columns(strips=list(lines_m)).partition(near.astype(int))
        self._writer.columns("world/nearest", times_s, columns)

    def _send_arrows(
        self, path: str, ticks: Sequence[Tick], velocity: Callable[[Tick], list[float] | None]
    ) -> None:
        """Send one arrow for each tick, none where there is no velocity."""
        arrows = [(tick.position_enu_m, velocity(tick)) for tick in ticks]
        present = [(position, vector) for position, vector in arrows if vector is not None]
        columns = rr.Arrows3D.columns(
            origins=motion.vectors([position for position, _ in present]),
            vectors=_ARROW_S * motion.vectors([vector for _, vector in present]),
        ).partition([int(vector is not None) for _, vector in arrows])
        self._writer.columns(path, [tick.time_s for tick in ticks], columns)

    def _send_senses(self, ticks: Sequence[Tick]) -> None:
        """Send what the actor saw, some times a second."""
        for tick in ticks:
            if tick.time_s < self._look_due_s:
                continue
            self._look_due_s = tick.time_s + _LOOK_S
            seen = self._senses.look(tick)
            rays_m = np.empty((0, 2, 3)) if seen is None else seen.rays_m
            way_m = np.empty((0, 3)) if seen is None else seen.way_m
            self._looks.append((tick.time_s, rays_m, way_m))
        if not self._looks:
            return
        times_s, rays, ways = zip(*self._looks, strict=True)
        self._looks = []
        columns = rr.LineStrips3D.columns(strips=[ray for each in rays for ray in each])
        self._writer.columns("world/seen/rays", times_s, columns.partition([len(r) for r in rays]))
        if any(len(way) for way in ways):
            columns = rr.LineStrips3D.columns(strips=[way for way in ways if len(way)])
            lengths = [int(len(way) > 0) for way in ways]
            self._writer.columns("world/seen/way", times_s, columns.partition(lengths))

    def _send_path(
        self, name: str, steps: Sequence[tuple[Tick, list[float] | None, Color]]
    ) -> None:
        path = self._paths[name]
        self._send_pieces(
            name,
            [
                path.extend(tick.time_s, position_m, color)
                for tick, position_m, color in steps
                if position_m is not None
            ],
        )

    def _send_pieces(self, name: str, found: Sequence[motion.Piece | None]) -> None:
        pieces = [piece for piece in found if piece is not None]
        if pieces:
            columns = rr.LineStrips3D.columns(
                strips=[piece.points_m for piece in pieces],
                colors=np.array([colors.packed(piece.color) for piece in pieces], np.uint32),
            )
            self._writer.columns(f"world/path/{name}", [piece.time_s for piece in pieces], columns)
