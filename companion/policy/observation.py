"""What the actor sees. Each layout is a table; simulator and vehicle fill it with one function.

Lengths are divided by the map's edge (100 m in the paper), so 1.0 is one edge. A layout's version
rises whenever the meaning of a column changes; an actor carries name, version and column names
and is refused where they differ.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from companion.arrays import Float32Array, FloatArray
from companion.policy.action import MIN_BEARING_DISTANCE_M
from companion.world.maps import Map


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


@dataclass(frozen=True, slots=True)
class Layout:
    """A named, versioned table of columns and the function that fills them."""

    name: str
    version: int
    fields: tuple[Field, ...]
    fill: Callable[[Float32Array, Situation], None]
    """Writes the columns into its first argument, shape ``(..., len(fields))``."""

    @property
    def columns(self) -> tuple[str, ...]:
        """Return the column names in order."""
        return tuple(field.name for field in self.fields)

    def bounds(self) -> tuple[Float32Array, Float32Array]:
        """Return the lower and the upper bounds, each of shape ``(n,)``."""
        low = np.array([field.low for field in self.fields], dtype=np.float32)
        high = np.array([field.high for field in self.fields], dtype=np.float32)
        return low, high


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

    # At the target itself there is no polar angle: horizontal.
    has_polar = distance_m >= MIN_BEARING_DISTANCE_M
    safe_distance_m = np.where(has_polar, distance_m, 1.0)
    out[..., 9] = np.where(has_polar, horizontal_m / safe_distance_m, 1.0)
    out[..., 10] = np.where(has_polar, offset_m[..., 2] / safe_distance_m, 0.0)


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

LAYOUTS: Mapping[str, Layout] = MappingProxyType(
    {layout.name: layout for layout in (PAPER, RELATIVE)}
)


def build_observation(
    layout: Layout,
    *,
    position_enu_m: npt.NDArray[np.floating],
    velocity_enu_mps: npt.NDArray[np.floating],
    target_enu_m: npt.NDArray[np.floating],
    map: Map,
) -> Float32Array:
    """Return what the actor sees, clipped to the layout's bounds.

    The one function behind training, evaluation and flight.

    Args:
        layout: Which columns.
        position_enu_m: Vehicle in map ENU, shape ``(..., 3)``.
        velocity_enu_mps: Vehicle in map ENU, shape ``(..., 3)``.
        target_enu_m: Target in map ENU, shape ``(..., 3)``.
        map: Where both are; its edge normalises lengths.

    Returns:
        Shape ``(..., len(layout.fields))``, float32. Numbers that are not finite pass through.
    """
    situation = Situation(
        np.asarray(position_enu_m, dtype=np.float64),
        np.asarray(velocity_enu_mps, dtype=np.float64),
        np.asarray(target_enu_m, dtype=np.float64),
        map,
    )
    batch = np.broadcast_shapes(
        situation.position_enu_m.shape[:-1], situation.target_enu_m.shape[:-1]
    )
    observation = np.empty((*batch, len(layout.fields)), dtype=np.float32)
    layout.fill(observation, situation)
    low, high = layout.bounds()
    return np.clip(observation, low, high, out=observation)


def describe_layout(layout: Layout) -> str:
    """Return the layout as a table for people, one line a column."""
    width = max(len(column) for column in layout.columns)
    lines = [f"layout {layout.name}, version {layout.version}, {len(layout.fields)} columns"]
    for index, field in enumerate(layout.fields):
        bounds = f"{field.low:5.2f} .. {field.high:4.2f}"
        lines.append(f"  {index:2d}  {field.name:<{width}}  {bounds}  {field.meaning}")
    return "\n".join(lines)
