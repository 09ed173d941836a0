"""What the actor sees. Each layout is a table; simulator and vehicle fill it with one function.

Lengths are divided by the map's edge (100 m in the paper), so 1.0 is one edge. A layout's version
rises whenever the meaning of a column changes; an actor carries name, version and column names
and is refused where they differ.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from companion.arrays import Float32Array, FloatArray
from companion.policy.action import MIN_BEARING_DISTANCE_M, bearing_to_target_rad
from companion.policy.horizon import way_within_horizon, within_horizon
from companion.world.maps import Map
from companion.world.way_ahead import WayAhead

NUM_RAYS = 24
RAYS_RANGE_M = 50.0
RAYS_UNIT_M = 100.0
RAYS_SPEED_MPS = 10.0
WAYS_TURN_M = 25.0
WAYS_LEFT_M = 200.0
WAYS_CLOSE_M = 5.0
_FAN_RAD = np.arange(NUM_RAYS) * (2.0 * np.pi / NUM_RAYS)


@dataclass(frozen=True, slots=True)
class Field:
    """One column of an observation."""

    name: str
    low: float
    high: float
    meaning: str


@dataclass(frozen=True, slots=True)
class Situation:
    """What a column may be computed from: map ENU, batched, shape ``(..., 3)`` each."""

    position_enu_m: FloatArray
    velocity_enu_mps: FloatArray
    target_enu_m: FloatArray
    map: Map
    ahead: WayAhead | None = None
    """Of layouts that show it."""


@dataclass(frozen=True, slots=True)
class Layout:
    """A named, versioned table of columns and the function that fills them."""

    name: str
    version: int
    fields: tuple[Field, ...]
    fill: Callable[[Float32Array, Situation], None]
    """Writes the columns into its first argument, shape ``(..., len(fields))``."""
    sees_obstacles: bool = False
    """Whether columns tell of obstacles; else an actor can only learn a map by heart."""
    shows_way: bool = False
    """Whether columns tell of the way round. The view, and psi with it, are then turned toward
    the aim, the farthest point of the way in sight, instead of toward the target."""
    _bounds: tuple[Float32Array, Float32Array] = dataclasses.field(
        init=False, repr=False, compare=False
    )

    @property
    def columns(self) -> tuple[str, ...]:
        """Return the column names in order."""
        return tuple(field.name for field in self.fields)

    def bounds(self) -> tuple[Float32Array, Float32Array]:
        """Return the lower and the upper bounds, each of shape ``(n,)``, not to be changed."""
        return self._bounds

    def __post_init__(self) -> None:
        bounds = np.array([(field.low, field.high) for field in self.fields], dtype=np.float32)
        bounds.setflags(write=False)
        object.__setattr__(self, "_bounds", tuple(np.ascontiguousarray(bounds.T)))


def _fill_paper(out: Float32Array, situation: Situation) -> None:
    edge_m = situation.map.edge_m
    out[..., 0:3] = situation.position_enu_m / edge_m
    out[..., 3:6] = situation.target_enu_m / edge_m


def _fill_relative(out: Float32Array, situation: Situation) -> None:
    edge_m = situation.map.edge_m
    offset_m = situation.target_enu_m - situation.position_enu_m
    horizontal_m = np.hypot(offset_m[..., 0], offset_m[..., 1])
    distance_m = np.hypot(horizontal_m, offset_m[..., 2])
    out[..., 0:3] = 2.0 * situation.position_enu_m / edge_m - 1.0
    out[..., 3:6] = offset_m / edge_m
    out[..., 6] = distance_m / edge_m

    # Straight above or below there is no bearing: 0 (map east), as in the action.
    has_bearing = horizontal_m >= MIN_BEARING_DISTANCE_M
    safe_horizontal_m = np.where(has_bearing, horizontal_m, 1.0)
    out[..., 7] = np.where(has_bearing, offset_m[..., 1] / safe_horizontal_m, 0.0)
    out[..., 8] = np.where(has_bearing, offset_m[..., 0] / safe_horizontal_m, 1.0)
    _fill_polar(out[..., 9:11], horizontal_m, offset_m[..., 2], distance_m)


def _fill_polar(
    out: Float32Array, horizontal_m: FloatArray, up_m: FloatArray, distance_m: FloatArray
) -> None:
    # At the target itself there is no polar angle: horizontal.
    has_polar = distance_m >= MIN_BEARING_DISTANCE_M
    safe_distance_m = np.where(has_polar, distance_m, 1.0)
    out[..., 0] = np.where(has_polar, horizontal_m / safe_distance_m, 1.0)
    out[..., 1] = np.where(has_polar, up_m / safe_distance_m, 0.0)


def _fill_rays(out: Float32Array, situation: Situation) -> None:
    offset_m = situation.target_enu_m - situation.position_enu_m
    position_m = np.broadcast_to(situation.position_enu_m, offset_m.shape)
    obstacles, height_m = situation.map.obstacles, position_m[..., 2]
    horizontal_m = np.hypot(offset_m[..., 0], offset_m[..., 1])
    distance_m = np.hypot(horizontal_m, offset_m[..., 2])
    out[..., 0] = horizontal_m / RAYS_UNIT_M
    out[..., 1] = offset_m[..., 2] / RAYS_UNIT_M
    out[..., 2] = distance_m / RAYS_UNIT_M
    _fill_polar(out[..., 3:5], horizontal_m, offset_m[..., 2], distance_m)
    out[..., 5] = height_m / RAYS_UNIT_M
    out[..., 6] = (situation.map.size_m[2] - height_m) / RAYS_UNIT_M
    out[..., 7] = (height_m - obstacles.floor_m(position_m)) / RAYS_UNIT_M

    bearing_rad = bearing_to_target_rad(situation.position_enu_m, situation.target_enu_m)
    _fill_velocity(out[..., 8:11], situation, (np.cos(bearing_rad), np.sin(bearing_rad)))
    wall_m, roof_m = obstacles.horizontal_rays(
        position_m, bearing_rad[..., None] + _FAN_RAD, RAYS_RANGE_M
    )
    out[..., 11 : 11 + NUM_RAYS] = wall_m / RAYS_RANGE_M
    left_m = np.where(roof_m > 0.0, roof_m - height_m[..., None], 0.0)
    out[..., 11 + NUM_RAYS :] = left_m / RAYS_UNIT_M


def _fill_velocity(
    out: Float32Array, situation: Situation, turn: tuple[FloatArray, FloatArray]
) -> None:
    ahead_mps, left_mps, up_mps = _turned(situation.velocity_enu_mps, turn)
    out[..., 0] = ahead_mps / RAYS_SPEED_MPS
    out[..., 1] = left_mps / RAYS_SPEED_MPS
    out[..., 2] = up_mps / RAYS_SPEED_MPS


def _turned(
    vector_enu: FloatArray, turn: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the parts of vectors ``(..., 3)`` ahead, to the left and up.

    ``turn`` holds the cosine and the sine of the bearing that is ahead.
    """
    east, north, up = vector_enu[..., 0], vector_enu[..., 1], vector_enu[..., 2]
    cos, sin = turn
    return east * cos + north * sin, north * cos - east * sin, up


def _fill_ways(out: Float32Array, situation: Situation) -> None:
    way = situation.ahead
    if way is None:
        raise ValueError("layout ways shows the way ahead: it must be given")
    position_m, target_m = np.broadcast_arrays(situation.position_enu_m, situation.target_enu_m)
    obstacles, height_m = situation.map.obstacles, position_m[..., 2]
    bearing_rad = bearing_to_target_rad(position_m, way.aim_enu_m)
    turn = np.cos(bearing_rad), np.sin(bearing_rad)

    to_aim_m = way.aim_enu_m - position_m
    horizontal_m = np.hypot(to_aim_m[..., 0], to_aim_m[..., 1])
    distance_m = np.hypot(horizontal_m, to_aim_m[..., 2])
    out[..., 0] = horizontal_m / RAYS_UNIT_M
    out[..., 1] = to_aim_m[..., 2] / RAYS_UNIT_M
    _fill_polar(out[..., 2:4], horizontal_m, to_aim_m[..., 2], distance_m)
    for column, part_m in enumerate(_turned(way.beyond_enu_m - way.aim_enu_m, turn)):
        out[..., 4 + column] = part_m / WAYS_TURN_M
    for column, part_m in enumerate(_turned(target_m - position_m, turn)):
        out[..., 7 + column] = part_m / RAYS_UNIT_M
    out[..., 10] = np.sqrt(np.square(target_m - position_m).sum(axis=-1)) / RAYS_UNIT_M
    out[..., 11] = way.left_m / WAYS_LEFT_M
    out[..., 12] = height_m / RAYS_UNIT_M
    out[..., 13] = (situation.map.size_m[2] - height_m) / RAYS_UNIT_M
    out[..., 14] = _closeness(height_m - obstacles.floor_m(position_m))
    _fill_velocity(out[..., 15:18], situation, turn)

    wall_m, roof_m = obstacles.horizontal_rays(
        position_m, bearing_rad[..., None] + _FAN_RAD, RAYS_RANGE_M
    )
    out[..., 18 : 18 + NUM_RAYS] = _closeness(wall_m)
    left_m = np.where(roof_m > 0.0, roof_m - height_m[..., None], 0.0)
    out[..., 18 + NUM_RAYS :] = left_m / RAYS_UNIT_M


def _closeness(distance_m: FloatArray) -> FloatArray:
    """Return 0 at an obstacle, 0.5 at 5 m, nearly 1 far off: fine where it matters."""
    at_least_m = np.maximum(distance_m, 0.0)
    closeness: FloatArray = at_least_m / (at_least_m + WAYS_CLOSE_M)
    return closeness


PAPER = Layout(
    name="paper",
    version=1,
    fields=(
        Field("x_u", 0.0, 1.0, "vehicle, east of the map's corner / edge"),
        Field("y_u", 0.0, 1.0, "vehicle, north of the map's corner / edge"),
        Field("z_u", 0.0, 1.0, "vehicle, above the ground / edge"),
        Field("x_d", 0.0, 1.0, "target, east of the map's corner / edge"),
        Field("y_d", 0.0, 1.0, "target, north of the map's corner / edge"),
        Field("z_d", 0.0, 1.0, "target, above the ground / edge"),
    ),
    fill=_fill_paper,
)
"""The paper's state as it stands: where the vehicle is and where the target is."""

RELATIVE = Layout(
    name="relative",
    version=1,
    fields=(
        Field("position_east", -1.0, 1.0, "vehicle, from the west to the east border"),
        Field("position_north", -1.0, 1.0, "vehicle, from the south to the north border"),
        Field("position_up", -1.0, 1.0, "vehicle, from the ground to one edge up"),
        Field("offset_east", -1.0, 1.0, "target minus vehicle, east / edge"),
        Field("offset_north", -1.0, 1.0, "target minus vehicle, north / edge"),
        Field("offset_up", -1.0, 1.0, "target minus vehicle, up / edge"),
        Field("distance", 0.0, float(np.sqrt(3.0)), "vehicle to target / edge"),
        Field("bearing_sin", -1.0, 1.0, "sine of the azimuth of the target"),
        Field("bearing_cos", -1.0, 1.0, "cosine of the azimuth of the target"),
        Field("polar_sin", 0.0, 1.0, "sine of the polar angle of the target"),
        Field("polar_cos", -1.0, 1.0, "cosine of the polar angle of the target"),
    ),
    fill=_fill_relative,
)
"""The same information seen from the vehicle: no wrap of psi between vehicle and target."""

RAYS = Layout(
    name="rays",
    version=1,
    fields=(
        Field("offset_ahead", 0.0, 1.5, "target, horizontal distance / 100 m"),
        Field("offset_up", -1.0, 1.0, "target minus vehicle, up / 100 m"),
        Field("distance", 0.0, 2.0, "vehicle to target / 100 m"),
        Field("polar_sin", 0.0, 1.0, "sine of the polar angle of the target"),
        Field("polar_cos", -1.0, 1.0, "cosine of the polar angle of the target"),
        Field("height", 0.0, 1.0, "vehicle above the ground / 100 m"),
        Field("headroom", 0.0, 1.0, "vehicle below the ceiling / 100 m"),
        Field("floor", -1.0, 1.0, "vehicle above roof or ground / 100 m"),
        Field("velocity_ahead", -1.0, 1.0, "toward the target, horizontal / 10 m/s"),
        Field("velocity_left", -1.0, 1.0, "left of the target / 10 m/s"),
        Field("velocity_up", -1.0, 1.0, "up / 10 m/s"),
        *(
            Field(
                f"wall_{ray:02d}", 0.0, 1.0, f"wall {ray * 360 // NUM_RAYS} deg to the left / 50 m"
            )
            for ray in range(NUM_RAYS)
        ),
        *(
            Field(f"roof_{ray:02d}", 0.0, 1.0, "its roof above the vehicle / 100 m")
            for ray in range(NUM_RAYS)
        ),
    ),
    fill=_fill_rays,
    sees_obstacles=True,
)
"""What surrounds the vehicle, turned so that the target lies ahead: good for any map.

Rays run horizontally at the vehicle's height, the first toward the target, then to the left
(counter-clockwise from above). Where a ray is free for 50 m, wall is 1 and roof 0. Lengths have
a fixed unit, not the map's edge: nothing in it depends on the size of the map. A target beyond the
horizon is shown nearer (``companion.policy.horizon``).
"""

WAYS = Layout(
    name="ways",
    version=1,
    fields=(
        Field("aim_ahead", 0.0, 1.5, "aim, horizontal distance / 100 m"),
        Field("aim_up", -1.0, 1.0, "aim minus vehicle, up / 100 m"),
        Field("aim_polar_sin", 0.0, 1.0, "sine of the aim's polar angle"),
        Field("aim_polar_cos", -1.0, 1.0, "cosine of the aim's polar angle"),
        Field("turn_ahead", -1.0, 1.0, "the way behind the aim, ahead / 25 m"),
        Field("turn_left", -1.0, 1.0, "the way behind the aim, to the left / 25 m"),
        Field("turn_up", -1.0, 1.0, "the way behind the aim, up / 25 m"),
        Field("target_ahead", -1.5, 1.5, "target minus vehicle, ahead / 100 m"),
        Field("target_left", -1.5, 1.5, "target minus vehicle, left / 100 m"),
        Field("target_up", -1.0, 1.0, "target minus vehicle, up / 100 m"),
        Field("distance", 0.0, 2.0, "vehicle to target / 100 m"),
        Field("way_left", 0.0, 2.0, "rest of the way, as level flight / 200 m"),
        Field("height", 0.0, 1.0, "vehicle above the ground / 100 m"),
        Field("headroom", 0.0, 1.0, "vehicle below the ceiling / 100 m"),
        Field("floor", 0.0, 1.0, "d / (d + 5 m), d above roof or ground"),
        Field("velocity_ahead", -1.0, 1.0, "toward the aim, horizontal / 10 m/s"),
        Field("velocity_left", -1.0, 1.0, "left of the aim / 10 m/s"),
        Field("velocity_up", -1.0, 1.0, "up / 10 m/s"),
        *(
            Field(
                f"wall_{ray:02d}",
                0.0,
                1.0,
                f"wall {ray * 360 // NUM_RAYS} deg to the left, d / (d + 5 m)",
            )
            for ray in range(NUM_RAYS)
        ),
        *(
            Field(f"roof_{ray:02d}", 0.0, 1.0, "its roof above the vehicle / 100 m")
            for ray in range(NUM_RAYS)
        ),
    ),
    fill=_fill_ways,
    sees_obstacles=True,
    shows_way=True,
)
"""The way round and what surrounds the vehicle, turned so that the next leg lies ahead.

Rays alone cannot see the way out of a court or round a long block: ``companion.world.ways`` knows
it. The action's psi is measured from the bearing to the aim, so that the zero action flies along
the way. Rays as in ``rays``, but near walls are told apart more finely than far ones.
"""

LAYOUTS: Mapping[str, Layout] = MappingProxyType(
    {layout.name: layout for layout in (PAPER, RELATIVE, RAYS, WAYS)}
)


def build_observation(
    layout: Layout,
    *,
    position_enu_m: npt.NDArray[np.floating],
    velocity_enu_mps: npt.NDArray[np.floating],
    target_enu_m: npt.NDArray[np.floating],
    map: Map,
    ahead: WayAhead | None = None,
) -> Float32Array:
    """Return what the actor sees, clipped to the layout's bounds.

    The one function behind training, evaluation and flight.

    Args:
        layout: Which columns.
        position_enu_m: Vehicle in map ENU, shape ``(..., 3)``.
        velocity_enu_mps: Vehicle in map ENU, shape ``(..., 3)``.
        target_enu_m: Target in map ENU, shape ``(..., 3)``.
        map: Where both are; its edge normalises lengths.
        ahead: The way ahead, of as many rows; for layouts that show it.

    Returns:
        Shape ``(..., len(layout.fields))``, float32. Numbers that are not finite pass through.
    """
    position_m = np.asarray(position_enu_m, dtype=np.float64)
    velocity_mps = np.asarray(velocity_enu_mps, dtype=np.float64)
    target_m = np.asarray(target_enu_m, dtype=np.float64)
    if layout.sees_obstacles:
        if ahead is not None:
            ahead = way_within_horizon(position_m, target_m, ahead)
        target_m = within_horizon(position_m, target_m)
    situation = Situation(position_m, velocity_mps, target_m, map, ahead)
    batch = np.broadcast_shapes(
        situation.position_enu_m.shape[:-1], situation.target_enu_m.shape[:-1]
    )
    observation = np.empty((*batch, len(layout.fields)), dtype=np.float32)
    layout.fill(observation, situation)
    low, high = layout.bounds()
    np.maximum(observation, low, out=observation)
    return np.minimum(observation, high, out=observation)


def describe_layout(layout: Layout, seen: Sequence[tuple[float, float]] = ()) -> str:
    """Return the layout as a table for people, one line a column.

    Args:
        layout: To be described.
        seen: What training has shown of each column, if that is known.
    """
    width = max(len(column) for column in layout.columns)
    lines = [f"layout {layout.name}, version {layout.version}, {len(layout.fields)} columns"]
    for index, field in enumerate(layout.fields):
        bounds = f"{field.low:5.2f} .. {field.high:4.2f}"
        if seen:
            bounds += f"  seen {seen[index][0]:5.2f} .. {seen[index][1]:5.2f}"
        lines.append(f"  {index:2d}  {field.name:<{width}}  {bounds}  {field.meaning}")
    return "\n".join(lines)
