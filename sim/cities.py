"""Random cities: streets and blocks at some angle, and on the blocks what cities are made of.

An actor that is to fly over maps it has never seen trains on cities of the training split and
is judged on those of the test split. The splits share no random stream, so no city can be in
two of them, whatever the numbers.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import shapely

from companion.arrays import FloatArray
from companion.world.maps import Map, build_map

MIN_SIDE_M = 5.0
"""No slab is thinner."""
_MIN_THICKNESS_M = 3.0
"""What the border cuts thinner than this is dropped."""
_LAUNCH_CANDIDATES = 64


class CitySplit(StrEnum):
    """What a city may be used for."""

    TRAINING = "training"
    VALIDATION = "validation"
    TEST = "test"


_STREAM = {CitySplit.TRAINING: 1, CitySplit.VALIDATION: 2, CitySplit.TEST: 4}
"""Test cities came from stream 3 until actors had been chosen with an eye on their results there;
those that are judged now are new to everybody."""


@dataclass(frozen=True, slots=True)
class CityStyle:
    """What cities look like. Pairs are the least and the largest of a uniform draw."""

    size_m: tuple[float, float, float] = (100.0, 100.0, 100.0)
    street_m: tuple[float, float] = (6.0, 12.0)
    """Width of streets."""
    block_m: tuple[float, float] = (16.0, 32.0)
    """Sides of blocks."""
    density: float = 0.9
    """Share of blocks that are built on; the others are open."""
    height_m: tuple[float, float] = (8.0, 100.0)
    """From the lowest shed to the highest tower."""
    tower_share: float = 0.35
    shed_share: float = 0.1
    court_share: float = 0.25
    """Blocks around a courtyard that is open on one side: a trap for who flies straight. What
    the three shares leave over are slabs and corners."""

    def __post_init__(self) -> None:
        for name, (low, high) in (
            ("street_m", self.street_m),
            ("block_m", self.block_m),
            ("height_m", self.height_m),
        ):
            if not 0.0 < low <= high:
                raise ValueError(f"{name} must be positive and ascend, got {low} and {high}")
        if self.block_m[0] < MIN_SIDE_M:
            raise ValueError(f"blocks must be at least {MIN_SIDE_M} m, got {self.block_m[0]}")
        if self.height_m[1] > self.size_m[2]:
            raise ValueError(f"height_m reaches above the ceiling of {self.size_m[2]} m")
        shares = (self.tower_share, self.shed_share, self.court_share)
        if not 0.0 <= self.density <= 1.0 or min(shares) < 0.0 or sum(shares) > 1.0:
            raise ValueError("density and the sum of the shares must be in [0, 1]")


def random_city(split: CitySplit | str, number: int, style: CityStyle | None = None) -> Map:
    """Return one city; the same arguments give the same city for ever.

    Args:
        split: What it will be used for.
        number: Which one, from 0.
        style: What it looks like.

    Returns:
        A map named after split and number, with a launch point on open ground.
    """
    split = CitySplit(split)
    style = CityStyle() if style is None else style
    stream = np.random.SeedSequence(entropy=number, spawn_key=(_STREAM[split],))
    rng = np.random.default_rng(stream)
    footprints: list[FloatArray] = []
    heights_m: list[float] = []
    for footprint, height_m in _buildings(style, rng):
        for part in _inside(footprint, style):
            footprints.append(part)
            heights_m.append(height_m)
    return build_map(
        f"{split}-{number}",
        style.size_m,
        footprints,
        heights_m,
        description=f"Random city {number} of the {split} split.",
        launch_enu_m=_launch_point(footprints, style, rng),
    )


def _buildings(style: CityStyle, rng: np.random.Generator) -> Iterator[tuple[FloatArray, float]]:
    """Yield outlines and heights, some of them beyond the border."""
    center_m = 0.5 * np.array(style.size_m[:2])
    reach_m = float(np.hypot(*center_m)) + style.block_m[1]
    angle_rad = rng.uniform(-np.pi / 4.0, np.pi / 4.0)
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    turn = np.array(((cos, sin), (-sin, cos)))
    for west_m, width_m in _blocks(style, rng, reach_m):
        for south_m, depth_m in _blocks(style, rng, reach_m):
            if rng.random() >= style.density:
                continue
            outline, height_m = _building(width_m, depth_m, style, rng)
            corner_m = np.array((west_m, south_m))
            yield (outline + corner_m) @ turn + center_m, height_m


def _blocks(
    style: CityStyle, rng: np.random.Generator, reach_m: float
) -> Iterator[tuple[float, float]]:
    """Yield begin and length of the blocks along an axis, from ``-reach_m`` to ``reach_m``."""
    begin_m = -reach_m - rng.uniform(0.0, style.block_m[1])
    while begin_m < reach_m:
        length_m = rng.uniform(*style.block_m)
        yield begin_m, length_m
        begin_m += length_m + rng.uniform(*style.street_m)


def _building(
    width_m: float, depth_m: float, style: CityStyle, rng: np.random.Generator
) -> tuple[FloatArray, float]:
    """Return the outline within ``(0, 0)`` and ``(width, depth)``, and the height."""
    kind = rng.random()
    low_m, span_m = style.height_m[0], style.height_m[1] - style.height_m[0]
    if kind < style.tower_share:
        return _tower(width_m, depth_m, rng), low_m + span_m * rng.uniform(0.5, 1.0)
    kind -= style.tower_share
    if kind < style.shed_share:
        return _rectangle(width_m, depth_m), low_m + span_m * rng.uniform(0.0, 0.2)
    kind -= style.shed_share
    height_m = low_m + span_m * rng.uniform(0.25, 0.9)
    if kind < style.court_share:
        return _court(width_m, depth_m, rng), height_m
    if rng.random() < 0.5:
        return _corner(width_m, depth_m, rng), height_m
    share = rng.uniform(0.5, 1.0, 2)
    slab = _rectangle(max(MIN_SIDE_M, width_m * share[0]), max(MIN_SIDE_M, depth_m * share[1]))
    return slab, height_m


def _rectangle(width_m: float, depth_m: float) -> FloatArray:
    return np.array(((0.0, 0.0), (width_m, 0.0), (width_m, depth_m), (0.0, depth_m)))


def _tower(width_m: float, depth_m: float, rng: np.random.Generator) -> FloatArray:
    """A regular polygon of 4 to 12 corners somewhere on its block."""
    most_m = 0.5 * min(width_m, depth_m)
    radius_m = rng.uniform(min(4.0, most_m), most_m)
    corners = int(rng.choice((4, 4, 6, 8, 12)))
    angle_rad = np.linspace(0.0, 2.0 * np.pi, corners, endpoint=False) + np.pi / corners
    ring = radius_m * np.stack((np.cos(angle_rad), np.sin(angle_rad)), axis=1)
    room_m = np.array((width_m, depth_m)) - 2.0 * radius_m
    return ring + radius_m + rng.uniform(0.0, 1.0, 2) * room_m


def _court(width_m: float, depth_m: float, rng: np.random.Generator) -> FloatArray:
    """Three wings around a courtyard, open to one of four sides."""
    wing_m = rng.uniform(0.2, 0.3) * min(width_m, depth_m)
    turned = bool(rng.random() < 0.5)
    w, d = (depth_m, width_m) if turned else (width_m, depth_m)
    outline = np.array(
        (
            (0.0, 0.0),
            (w, 0.0),
            (w, d),
            (w - wing_m, d),
            (w - wing_m, wing_m),
            (wing_m, wing_m),
            (wing_m, d),
            (0.0, d),
        )
    )
    if rng.random() < 0.5:
        outline[:, 1] = d - outline[:, 1]
    return outline[:, ::-1].copy() if turned else outline


def _corner(width_m: float, depth_m: float, rng: np.random.Generator) -> FloatArray:
    """Two wings that meet in one of four corners."""
    wing_m = rng.uniform(0.25, 0.4) * min(width_m, depth_m)
    outline = np.array(
        (
            (0.0, 0.0),
            (width_m, 0.0),
            (width_m, wing_m),
            (wing_m, wing_m),
            (wing_m, depth_m),
            (0.0, depth_m),
        )
    )
    mirror = rng.random(2) < 0.5
    return np.where(mirror, (width_m, depth_m) - outline, outline)


def _inside(outline: FloatArray, style: CityStyle) -> Iterator[FloatArray]:
    """Yield the parts of an outline within the border that are worth building."""
    size_m = np.array(style.size_m[:2])
    if np.all((outline >= 0.0) & (outline <= size_m)):
        yield outline
        return
    cut = shapely.Polygon(outline).intersection(shapely.box(0.0, 0.0, *size_m))
    for part in getattr(cut, "geoms", (cut,)):
        if part.geom_type == "Polygon" and not part.buffer(-0.5 * _MIN_THICKNESS_M).is_empty:
            yield np.clip(np.asarray(part.exterior.coords)[:-1], 0.0, size_m)


def _launch_point(
    footprints: list[FloatArray], style: CityStyle, rng: np.random.Generator
) -> FloatArray:
    """Return the point on the ground with the most room, of a few random ones."""
    candidates_m = rng.uniform(0.05, 0.95, (_LAUNCH_CANDIDATES, 2)) * style.size_m[:2]
    built = shapely.MultiPolygon([shapely.Polygon(outline) for outline in footprints])
    room_m = shapely.distance(shapely.points(candidates_m), built)
    best = candidates_m[int(np.nanargmax(room_m))] if footprints else candidates_m[0]
    return np.array((*best, 0.0))
