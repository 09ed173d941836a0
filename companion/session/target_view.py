"""The target in the 3-D view: where it is, how far that can be trusted, and where to look for it.

A pole from the ground to above every roof carries its name: a target behind a building is found.
"""

from collections.abc import Sequence

import numpy as np
import rerun as rr

from companion.session import colors, motion
from companion.session.colors import Color
from companion.session.records import SessionStart, Tick
from companion.session.writer import StreamWriter

_TIERS: dict[str, Color] = {
    "coast": (255, 190, 60),
    "hold": (255, 140, 40),
    "lost": (255, 66, 66),
}
_MOVED_M = 0.1
_OVER_ROOFS = 1.06
_LEAST_MPS = 0.5  # what it may drift at, whatever its last velocity was
_LARGEST = 0.3  # of the map's edge


class TargetView:
    """Logs the target, a batch of ticks at a time."""

    def __init__(self, writer: StreamWriter, start: SessionStart) -> None:
        self._writer = writer
        self._start = start
        self._edge_m = max(start.map.size_m[:2])
        top_m = max(start.map.heights_m, default=0.3 * start.map.size_m[2])
        self._pole_top_m = _OVER_ROOFS * top_m
        self._pole_m: list[float] | None = None
        self._tier = ""
        self._name = "target" if start.actor.name else "other vehicle"
        self._begun = False

    def send(self, ticks: Sequence[Tick]) -> None:
        """Send one batch; every tick has a target."""
        if not self._begun:
            self._begin(ticks[0].time_s)
        position_m = motion.vectors([tick.target_enu_m for tick in ticks])
        pose = rr.Transform3D.columns(translation=position_m)
        self._writer.columns("world/target", [tick.time_s for tick in ticks], pose)
        self._send_pole(ticks)
        for tick in ticks:
            if tick.target_tier != self._tier:
                self._tier = tick.target_tier
                self._writer.at(tick.time_s, "world/target/sphere", self._sphere())
        self._send_doubt(ticks)

    def _begin(self, time_s: float) -> None:
        self._begun = True
        self._writer.at(time_s, "world/target/sphere", self._sphere())
        pole = rr.LineStrips3D.from_fields(
            colors=[(*colors.TARGET, 120)], radii=rr.Radius.ui_points(1.0)
        )
        self._writer.static("world/pole", pole)
        name = rr.Points3D.from_fields(
            colors=[colors.TARGET],
            radii=rr.Radius.ui_points(3.0),
            labels=[self._name],
            show_labels=True,
        )
        self._writer.static("world/pole/name", name)
        doubt = rr.Ellipsoids3D.from_fields(
            colors=[(*_TIERS["coast"], 160)], line_radii=rr.Radius.ui_points(0.8)
        )
        self._writer.static("world/target/doubt", doubt)

    def _sphere(self) -> rr.Ellipsoids3D:
        """Return the sphere within which the vehicle has arrived, in the colour of its tier."""
        color = _TIERS.get(self._tier, colors.TARGET)
        return rr.Ellipsoids3D(
            radii=[self._start.arrival_radius_m],
            colors=[(*color, 80)],
            fill_mode=rr.components.FillMode.Solid,
        )

    def _send_pole(self, ticks: Sequence[Tick]) -> None:
        times_s, poles, tops = [], [], []
        for tick in ticks:
            place = tick.target_enu_m
            if place is None or (
                self._pole_m is not None
                and np.abs(np.subtract(place, self._pole_m)).max() < _MOVED_M
            ):
                continue
            self._pole_m = place
            top = [place[0], place[1], max(self._pole_top_m, place[2])]
            times_s.append(tick.time_s)
            poles.append([[place[0], place[1], 0.0], top])
            tops.append(top)
        if times_s:
            self._writer.columns("world/pole", times_s, rr.LineStrips3D.columns(strips=poles))
            self._writer.columns("world/pole/name", times_s, rr.Points3D.columns(positions=tops))

    def _send_doubt(self, ticks: Sequence[Tick]) -> None:
        """Send the sphere that the target may have reached since it was last heard."""
        old = [tick for tick in ticks if tick.target_tier in _TIERS]
        if not old:
            return
        sizes = []
        for tick in old:
            speed_mps = float(np.linalg.norm(tick.target_velocity_enu_mps or [0.0]))
            doubt_m = max(_LEAST_MPS, speed_mps) * (tick.target_age_s or 0.0)
            sizes.append([min(doubt_m, _LARGEST * self._edge_m)] * 3)
        columns = rr.Ellipsoids3D.columns(half_sizes=sizes)
        self._writer.columns("world/target/doubt", [tick.time_s for tick in old], columns)


def _near(place_m: list[float], other_m: list[float] | None) -> bool:
    return other_m is not None and float(np.abs(np.subtract(place_m, other_m)).max()) < _MOVED_M
