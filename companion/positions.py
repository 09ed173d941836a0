"""Vehicle and target on the map: ties the map to the autopilot's local frame, tracks the target.

The tie is made again whenever the autopilot's origin moves or its estimator resets
(``VehicleState.frame_epoch``); a reported target is then forgotten and has to be heard anew.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from companion.arrays import FloatArray
from companion.guidance.target import TargetEstimate, TargetTrack
from companion.vehicle import FRAME_RESIDUAL_M, LandedState, TargetReport, VehicleState
from companion.world.frames import GeoPoint, LocalTie
from companion.world.maps import Map

APART_S = 0.5
"""Local and global position may be apart for so long: the one may lag a step of the other."""


@dataclass(frozen=True, slots=True)
class TargetSource:
    """Where the target comes from; with nothing given, DO_REPOSITION addressed to us sets it."""

    position_enu_m: FloatArray | None = None
    geodetic: GeoPoint | None = None
    system_id: int | None = None

    @property
    def given(self) -> bool:
        """Return whether there is any target but one that may yet be sent to us."""
        return self.position_enu_m is not None or self.expected

    @property
    def expected(self) -> bool:
        """Return whether a target has to be known before a flight starts."""
        return self.geodetic is not None or self.system_id is not None


@dataclass(frozen=True, slots=True)
class Pose:
    """The vehicle on the map."""

    position_enu_m: FloatArray
    velocity_enu_mps: FloatArray
    height_m: float
    """Above the place where the vehicle last stood."""


@dataclass(frozen=True, slots=True)
class _Posed:
    """A pose and what it was made from."""

    pose: Pose
    tie: LocalTie
    position_ned_m: FloatArray
    ground_down_m: float


class Positions:
    """Owns the tie between map and local frame, and the target's track."""

    def __init__(
        self, city: Map, source: TargetSource, *, earth_radius_m: float | None = None
    ) -> None:
        """Start with nothing known.

        Args:
            city: The map.
            source: Where the target comes from.
            earth_radius_m: ``VehicleInfo.earth_radius_m``.
        """
        self._map = city
        self._earth_radius_m = earth_radius_m
        self._source = source
        self._tie: LocalTie | None = None
        self._tied_with_origin = False
        self._frame_epoch: int | None = None
        self._frame_moved = False
        self._ground_down_m: float | None = None
        self._posed: _Posed | None = None
        self._geodetic_pending = source.geodetic
        self._apart_since_s: float | None = None
        self.untied = ""
        """How local and global position contradict each other; empty when they agree."""
        self.track = TargetTrack(source.position_enu_m)

    @property
    def tie(self) -> LocalTie | None:
        """Return the tie between map and local frame, ``None`` while there is none."""
        return self._tie

    def update(
        self, state: VehicleState | None, reports: Mapping[int, TargetReport]
    ) -> Pose | None:
        """Take in the newest telemetry.

        Returns:
            The vehicle on the map, ``None`` while it cannot be placed.
        """
        if state is None:
            return None
        self._look_at_residual(state)
        moved = self._frame_epoch is not None and state.frame_epoch != self._frame_epoch
        has_origin = state.origin is not None
        if self._tie is None or moved or has_origin != self._tied_with_origin:
            self._tie = self._tie_map(state)
            self._tied_with_origin = has_origin
        if moved:
            self._frame_moved = True
            self.track.forget()
            self._geodetic_pending = self._source.geodetic
        self._frame_epoch = state.frame_epoch
        down_m = float(state.position_ned_m[2])
        if self._ground_down_m is None or state.landed is LandedState.ON_GROUND:
            self._ground_down_m = down_m
        if self._tie is None:
            return None
        self._take_reports(self._tie, reports)
        return self._placed(self._tie, state, self._ground_down_m)

    def take_frame_moved(self) -> bool:
        """Return whether the local frame has moved since the last call."""
        moved, self._frame_moved = self._frame_moved, False
        return moved

    def target(self, now_s: float) -> TargetEstimate:
        """Return the target as it stands at ``now_s``."""
        return self.track.estimate(now_s)

    def on_map(self, point: GeoPoint) -> FloatArray | None:
        """Return a WGS84 point on the map, ``None`` while map and earth are not tied."""
        if self._tie is None or self._tie.map_origin is None:
            return None
        position_enu_m = self._tie.geodetic_to_map(point)
        # A beacon on the ground may read a little below it.
        position_enu_m[2] = max(0.0, position_enu_m[2])
        return position_enu_m

    def _placed(self, tie: LocalTie, state: VehicleState, ground_down_m: float) -> Pose:
        """Return the vehicle on the map: the very same object while no new position comes."""
        known = self._posed
        if (
            known is None
            or state.position_ned_m is not known.position_ned_m
            or tie is not known.tie
            or ground_down_m != known.ground_down_m
        ):
            pose = Pose(
                tie.position_to_map(state.position_ned_m),
                tie.velocity_to_map(state.velocity_ned_mps),
                ground_down_m - float(state.position_ned_m[2]),
            )
            known = self._posed = _Posed(pose, tie, state.position_ned_m, ground_down_m)
        return known.pose

    def _look_at_residual(self, state: VehicleState) -> None:
        """Doubt the frame once its two positions have been apart for a while."""
        words = loose_tie(state.frame_residual_m)
        if not words:
            self._apart_since_s, self.untied = None, ""
            return
        if self._apart_since_s is None:
            self._apart_since_s = state.time_s
        if not self.untied and state.time_s - self._apart_since_s >= APART_S:
            self.untied = words

    def _tie_map(self, state: VehicleState) -> LocalTie | None:
        city, radius_m = self._map, self._earth_radius_m
        if city.origin is None:
            launch_enu_m = city.launch_enu_m
            if launch_enu_m is None:
                return None
            if self._tie is not None and self._tie.local_origin and state.origin:
                # The map stays where it lies on earth; the local origin has moved across it.
                launch_enu_m = self._tie.geodetic_to_map(state.origin)
            return LocalTie.from_launch(launch_enu_m, state.origin, earth_radius_m=radius_m)
        if state.origin is None:
            return None
        return LocalTie.from_origins(city.origin, state.origin, earth_radius_m=radius_m)

    def _take_reports(self, tie: LocalTie, reports: Mapping[int, TargetReport]) -> None:
        if self._geodetic_pending is not None:
            position_enu_m = self.on_map(self._geodetic_pending)
            if position_enu_m is not None:
                self.track.set_static(position_enu_m)
                self._geodetic_pending = None
        report = None if self._source.system_id is None else reports.get(self._source.system_id)
        if report is None:
            return
        position_enu_m = self.on_map(report.position)
        if position_enu_m is None:
            return
        velocity = report.velocity_ned_mps
        self.track.report(
            position_enu_m,
            None if velocity is None else tie.velocity_to_map(np.asarray(velocity)),
            time_s=report.time_s,
            source_time_s=report.source_time_s,
        )


def loose_tie(residual_m: float | None) -> str:
    """Return why local and global position cannot both be right."""
    if residual_m is not None and residual_m > FRAME_RESIDUAL_M:
        return (
            f"LOCAL_POSITION_NED and GLOBAL_POSITION_INT are {residual_m:.1f} m apart: "
            "the local origin is not where it is said to be"
        )
    return ""
