"""``companion maps import``: building footprints on earth become a map file."""

import math
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from companion.errors import MapError, UsageError
from companion.options import parse

if TYPE_CHECKING:
    from companion.world.map_box import MapBox

_NEGATIVE_STARTS = ("--box", "--center")
"""Options whose value may begin with a minus sign, south of the equator."""

_MOST_TOLERANT_M = 5.0
_HIGHEST_M = 10_000.0


@dataclass(frozen=True)
class ImportArgs:
    """Make a map of building footprints: GeoJSON (WGS84, UTM), or JSON from Overpass."""

    file: tyro.conf.Positional[Path]
    """Footprints: GeoJSON with polygons, as from overpass-turbo, osmtogeojson or GDAL; or Overpass
    JSON (`out geom`)."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE.yaml")] = None
    """Where to write (default NAME.yaml)."""
    box: Annotated[str | None, tyro.conf.arg(metavar="LAT,LON,LAT,LON")] = None
    """Two opposite corners; by default all buildings and 10 m around them."""
    center: Annotated[str | None, tyro.conf.arg(metavar="LAT,LON")] = None
    """Or the middle of a square of --size."""
    size: Annotated[float | None, tyro.conf.arg(metavar="M")] = None
    """Side of that square."""
    crs: Annotated[str, tyro.conf.arg(metavar="EPSG:CODE")] = ""
    """Of a file that does not name its coordinates: EPSG:3857 or a UTM zone, EPSG:32632."""
    ceiling: Annotated[float, tyro.conf.arg(metavar="M")] = 100.0
    """Height of the map; higher roofs end there."""
    altitude: Annotated[float | None, tyro.conf.arg(metavar="M")] = None
    """Of the ground, above mean sea level: what the autopilot's altitudes are compared with."""
    default_height: Annotated[float, tyro.conf.arg(metavar="M")] = 15.0
    """Of buildings with neither a height nor storeys."""
    tolerance: Annotated[float, tyro.conf.arg(metavar="M")] = 0.2
    """By how much outlines may change to have fewer corners."""
    name: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None
    """Of the map (default: of the file)."""
    force: Annotated[
        bool, tyro.conf.FlagCreatePairsOff, tyro.conf.arg(help="Overwrite the map if it exists.")
    ] = False


def import_command(argv: list[str]) -> int:
    """Run ``companion maps import``."""
    args = parse(ImportArgs, _joined(argv), "companion maps import")
    import_file(args)
    return 0


def import_file(args: ImportArgs) -> None:
    """Read footprints, write a map and print what became of them.

    Raises:
        UsageError: If an option makes no sense, or the map exists already.
        MapError: If no map can be made of the file; the message names it.
    """
    from companion.world.building_file import read_building_file
    from companion.world.import_report import describe_import, warnings_of
    from companion.world.map_import import ImportOptions, import_map
    from companion.world.map_writer import map_text, write_text

    _check_lengths(args)
    corners = _degrees("--box", args.box, 2)
    center = _degrees("--center", args.center, 1)
    if (corners and center) or (center is None) != (args.size is None):
        raise UsageError("choose the ground with --box, or with --center and --size, not both")
    name = args.name or _stem(args.file)
    out = args.out or Path(f"{name}.yaml")
    if out.suffix not in (".yaml", ".yml"):
        raise UsageError(f"--out {out}: the name of a map file ends with .yaml")
    if out.exists() and not args.force:
        raise UsageError(f"{out} exists: --force overwrites it, --out names another")
    try:
        outlines = read_building_file(args.file, args.crs)
        options = ImportOptions(
            name=name,
            source=args.file.name,
            box=_box(args, corners, center),
            altitude_m=args.altitude or 0.0,
            ceiling_m=args.ceiling,
            default_height_m=args.default_height,
            tolerance_m=args.tolerance,
        )
        city, report = import_map(outlines, options)
        text = map_text(city, f"Made by `companion maps import {args.file.name}`.")
    except MapError as error:
        # A file may hold anything, and parts of it end up in the message.
        problem = "".join(c if c.isprintable() else f"\\u{ord(c):04x}" for c in str(error))
        raise MapError(f"cannot import {args.file}: {problem}") from error
    write_text(out, text)
    print(describe_import(city, report, args.default_height))
    warnings = warnings_of(report)
    if args.altitude is None:
        warnings.append(
            "the ground is taken to be at 0 m AMSL: say --altitude before you fly there"
        )
    for warning in warnings:
        print(f"warning: {warning}", file=sys.stderr)
    print(f"wrote {out}")


def _box(
    args: ImportArgs,
    corners: list[tuple[float, float]] | None,
    center: list[tuple[float, float]] | None,
) -> "MapBox | None":
    from companion.world.map_box import MapBox

    altitude_m = args.altitude or 0.0
    if corners is not None:
        return MapBox.between(corners[0], corners[1], altitude_m)
    if center is not None and args.size is not None:
        return MapBox.around(center[0], args.size, altitude_m)
    return None


def _check_lengths(args: ImportArgs) -> None:
    for option, value in (
        ("--size", args.size),
        ("--ceiling", args.ceiling),
        ("--default-height", args.default_height),
    ):
        if value is not None and not 0.0 < value < math.inf:
            raise UsageError(f"{option} {value:g}: a length above 0 m")
    if args.altitude is not None and not abs(args.altitude) <= _HIGHEST_M:
        raise UsageError(f"--altitude {args.altitude:g}: metres above mean sea level")
    if not 0.0 <= args.tolerance <= _MOST_TOLERANT_M:
        raise UsageError(f"--tolerance {args.tolerance:g}: 0 to {_MOST_TOLERANT_M:g} m")
    if args.default_height > args.ceiling:
        raise UsageError(
            f"--default-height {args.default_height:g} is above --ceiling {args.ceiling:g}"
        )


def _degrees(option: str, text: str | None, count: int) -> list[tuple[float, float]] | None:
    """Return ``count`` places, latitude and longitude."""
    if text is None:
        return None
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    places = list(zip(numbers[::2], numbers[1::2], strict=False))
    if len(numbers) != 2 * count:
        wanted = ",".join(["LAT,LON"] * count)
        raise UsageError(f"{option} {text}: expected {wanted} in degrees")
    for latitude_deg, longitude_deg in places:
        if not (abs(latitude_deg) <= 90.0 and abs(longitude_deg) <= 180.0):
            raise UsageError(f"{option} {text}: no such latitude or longitude")
    return places


def _stem(path: Path) -> str:
    """Return the name of a file without its endings."""
    return path.name.split(".")[0] or path.name


def _joined(argv: list[str]) -> list[str]:
    """Join ``--box -33.8,...`` into one word: alone, a negative latitude looks like a flag."""
    joined: list[str] = []
    for word in argv:
        if joined and joined[-1] in _NEGATIVE_STARTS:
            joined[-1] = f"{joined[-1]}={word}"
        else:
            joined.append(word)
    return joined
