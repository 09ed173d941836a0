"""Maps: a box of air, the obstacles in it, and where it lies on earth.

The map frame is ENU in metres with its origin at the box's south-west ground corner. Maps come
from YAML files (``load_map``) or from footprints (``build_map``); both are checked alike.
"""

import hashlib
import json
import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np
import numpy.typing as npt
import shapely

from companion.arrays import BoolArray, FloatArray
from companion.errors import MapError
from companion.world.footprints import canonical_footprint, check_footprints
from companion.world.frames import GeoPoint
from companion.world.geometry import Obstacles
from companion.world.map_file import MapFile, read_map_file

_MOST_ROWS = 50
"""Of obstacles in a table for people."""
MAX_SIDE_M = 10_000.0
"""Over 10 km the ground falls 8 m away from a flat map."""


@dataclass(frozen=True, slots=True, eq=False)
class Map:
    """A map as it is used; make one with ``load_map`` or ``build_map``."""

    name: str
    description: str
    size_m: FloatArray  # (3,)
    """Extent east, north and up; also the geofence."""
    edge_m: float
    """Largest horizontal side: the unit of the policy's lengths."""
    obstacles: Obstacles
    footprints_m: tuple[FloatArray, ...]
    """As given, ``(V, 2)`` each, not closed."""
    heights_m: FloatArray  # (O,)
    obstacle_names: tuple[str, ...]
    origin: GeoPoint | None
    """The south-west ground corner on earth, if the map lies anywhere."""
    launch_enu_m: FloatArray | None  # (3,)
    """Where the autopilot's local origin lies, for maps without an origin."""
    content_hash: str
    """SHA-256 of what a policy can learn by heart: size and obstacles. Names, order, formatting
    and the place on earth do not count."""

    def contains(self, position_enu_m: FloatArray) -> BoolArray:
        """Return whether positions ``(..., 3)`` lie in the box or on its faces, ``(...)``."""
        position_m = np.asarray(position_enu_m)
        inside: BoolArray = np.all((position_m >= 0.0) & (position_m <= self.size_m), axis=-1)
        return inside

    def outside_m(self, position_enu_m: FloatArray) -> float:
        """Return how far a position ``(3,)`` is from the box; 0 inside, below the ground too.

        Below, because the ground of a real place is not flat.
        """
        east_m, north_m, up_m = position_enu_m.tolist()
        size_east_m, size_north_m, size_up_m = self.size_m.tolist()
        return math.hypot(
            max(-east_m, east_m - size_east_m, 0.0),
            max(-north_m, north_m - size_north_m, 0.0),
            max(up_m - size_up_m, 0.0),
        )

    def is_free(self, position_enu_m: FloatArray, margin_m: float = 0.0) -> BoolArray:
        """Return whether positions ``(..., 3)`` lie in the box, clear of obstacles, ``(...)``.

        Args:
            position_enu_m: Shape ``(..., 3)``.
            margin_m: The clearance must be larger than this; 0 refuses touching only.
        """
        clear: BoolArray = self.obstacles.signed_distance_m(position_enu_m) > margin_m
        return clear & self.contains(position_enu_m)


def build_map(
    name: str,
    size_m: npt.ArrayLike,
    footprints_m: Sequence[npt.ArrayLike],
    heights_m: Sequence[float],
    *,
    obstacle_names: Sequence[str] | None = None,
    description: str = "",
    origin: GeoPoint | None = None,
    launch_enu_m: npt.ArrayLike | None = None,
) -> Map:
    """Check and build a map.

    Args:
        name: What people call it.
        size_m: Extent east, north and up, shape ``(3,)``.
        footprints_m: Outlines, ``(V, 2)`` each, any orientation; a repeated first corner at the
            end is dropped.
        heights_m: One per footprint.
        obstacle_names: One per footprint, all different; ``obs1``, ``obs2`` ... if not given.
        description: A sentence for people.
        origin: Where the map lies on earth.
        launch_enu_m: Where the autopilot's local origin lies, shape ``(3,)``.

    Raises:
        MapError: If anything is wrong; the message names the field as in a map file.
    """
    size = np.array(size_m, dtype=np.float64)
    if size.shape != (3,) or not np.all((size > 0.0) & (size <= MAX_SIDE_M)):
        raise MapError(
            f"size_m must be three lengths between 0 and {MAX_SIDE_M:g} m, got {size.tolist()}"
        )
    if not name.strip() or not name.isprintable():
        raise MapError(f"name must be printable and not empty, got {name!r}")
    description = " ".join(description.split())
    if not description.isprintable():
        raise MapError(f"description must be printable, got {description!r}")
    if len(footprints_m) != len(heights_m):
        raise MapError(f"{len(heights_m)} heights for {len(footprints_m)} footprints")
    footprints = check_footprints(footprints_m, heights_m, size)
    names = _check_names(obstacle_names, len(footprints))
    if origin is not None:
        _check_origin(origin)
    built = Map(
        name=name,
        description=description,
        size_m=size,
        edge_m=float(size[:2].max()),
        obstacles=Obstacles(footprints, heights_m),
        footprints_m=footprints,
        heights_m=np.array(heights_m, dtype=np.float64),
        obstacle_names=names,
        origin=origin,
        launch_enu_m=None if launch_enu_m is None else np.array(launch_enu_m, dtype=np.float64),
        content_hash=_content_hash(size, footprints, heights_m),
    )
    launch_m = built.launch_enu_m
    if launch_m is not None and not built.contains(launch_m):
        raise MapError(f"launch_m {launch_m.tolist()} is outside the map")
    if launch_m is not None and not built.is_free(launch_m):
        raise MapError(f"launch_m {launch_m.tolist()} is inside an obstacle")
    return built


def load_map(path_or_name: str | Path) -> Map:
    """Load a map file, or a bundled map by its name.

    Raises:
        MapError: If there is no such map or something in it is wrong; the message names the file
            and the field.
    """
    path = Path(path_or_name)
    if path.name == str(path_or_name) and not path.suffix:
        path = _bundled_folder() / f"{path.name}.yaml"
        if not path.is_file():
            raise MapError(f"no map named {path_or_name}; bundled are {', '.join(bundled_maps())}")
    elif not path.exists():
        raise MapError(f"no map file {path}; bundled maps are {', '.join(bundled_maps())}")
    try:
        return _from_file(read_map_file(path))
    except MapError as error:
        # A file may hold anything, and its keys end up in the message.
        problem = "".join(c if c.isprintable() else f"\\u{ord(c):04x}" for c in str(error))
        raise MapError(f"cannot load map {path}: {problem}") from error


def bundled_maps() -> list[str]:
    """Return the names of the maps that come with the package."""
    return sorted(path.stem for path in _bundled_folder().glob("*.yaml"))


def describe_map(city: Map) -> str:
    """Return a table of the map for people, at most 80 columns wide, without a final newline."""
    size = " x ".join(f"{side:g}" for side in city.size_m)
    ground = shapely.union_all([shapely.Polygon(footprint) for footprint in city.footprints_m])
    share = 100.0 * ground.area / float(city.size_m[0] * city.size_m[1])
    count = len(city.obstacles)
    lines = [
        *textwrap.wrap(f"{city.name}: {city.description}" if city.description else city.name, 80),
        "",
        f"size       {size} m east, north, up",
        f"place      {_place(city)}",
        f"obstacles  {count or 'none'}{f', on {share:.1f} % of the ground' if count else ''}",
        f"hash       {city.content_hash}",
    ]
    if count:
        heading = f"{'obstacle':<20}{'height':>9}{'east':>18}{'north':>18}{'corners':>9}"
        lines += ["", heading, f"{'':<20}{'m':>9}{'m':>18}{'m':>18}"]
    # Of a whole town the highest, in the order of the file.
    shown = np.sort(np.argsort(-city.heights_m, kind="stable")[:_MOST_ROWS])
    for index in shown.tolist():
        name, footprint = city.obstacle_names[index], city.footprints_m[index]
        west, south = footprint.min(axis=0)
        east, north = footprint.max(axis=0)
        lines.append(
            f"{name if len(name) < 20 else name[:16] + '...':<20}{city.heights_m[index]:>9.1f}"
            f"{f'{west:.1f} - {east:.1f}':>18}{f'{south:.1f} - {north:.1f}':>18}{len(footprint):>9}"
        )
    if count > len(shown):
        lines.append(f"and {count - len(shown)} more, none of them higher")
    return "\n".join(lines)


def _place(city: Map) -> str:
    if city.origin is not None:
        return (
            f"south-west ground corner at {city.origin.latitude_deg:.6f}, "
            f"{city.origin.longitude_deg:.6f}, {city.origin.altitude_m:g} m AMSL"
        )
    if city.launch_enu_m is None:
        return "nowhere: neither origin nor launch_m, so it cannot be flown over a link"
    east_m, north_m, up_m = city.launch_enu_m
    return f"where the vehicle starts: its local origin is ({east_m:g}, {north_m:g}, {up_m:g}) m"


def _bundled_folder() -> Path:
    """A wheel carries ``maps/`` as ``companion/_maps``; a checkout keeps it at the root."""
    package = Path(str(files("companion")))
    packaged = package / "_maps"
    return packaged if packaged.is_dir() else package.parent / "maps"


def _from_file(file: MapFile) -> Map:
    if (file.origin is None) == (file.launch_m is None):
        given = "neither" if file.origin is None else "both"
        raise MapError(f"exactly one of origin and launch_m must be given, found {given}")
    entry = file.origin
    origin = (
        GeoPoint(entry.latitude_deg, entry.longitude_deg, entry.altitude_m)
        if entry is not None
        else None
    )
    return build_map(
        file.name,
        file.size_m,
        [obstacle.footprint_m for obstacle in file.obstacles],
        [obstacle.height_m for obstacle in file.obstacles],
        obstacle_names=[obstacle.name for obstacle in file.obstacles],
        description=file.description,
        origin=origin,
        launch_enu_m=file.launch_m,
    )


def _check_names(names: Sequence[str] | None, count: int) -> tuple[str, ...]:
    if names is None:
        return tuple(f"obs{number}" for number in range(1, count + 1))
    if len(names) != count:
        raise MapError(f"{len(names)} obstacle names for {count} obstacles")
    taken: set[str] = set()
    for index, name in enumerate(names):
        if not name.strip() or not name.isprintable():
            raise MapError(f"obstacles[{index}].name must be printable and not empty, got {name!r}")
        if name in taken:
            raise MapError(f"obstacles[{index}].name {name} is taken by another obstacle")
        taken.add(name)
    return tuple(names)


def _check_origin(origin: GeoPoint) -> None:
    for field, value, limit in (
        ("latitude_deg", origin.latitude_deg, 90.0),
        ("longitude_deg", origin.longitude_deg, 180.0),
        ("altitude_m", origin.altitude_m, 10_000.0),
    ):
        if not (math.isfinite(value) and abs(value) <= limit):
            raise MapError(f"origin.{field} must be within {-limit:g} and {limit:g}, got {value}")


def _content_hash(
    size_m: FloatArray, footprints_m: Sequence[FloatArray], heights_m: Sequence[float]
) -> str:
    obstacles = sorted(
        [float(height_m), canonical_footprint(footprint)]
        for footprint, height_m in zip(footprints_m, heights_m, strict=True)
    )
    content = json.dumps({"obstacles": obstacles, "size_m": size_m.tolist()}, sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()
