"""Map files: YAML from people, read into typed values. What they mean is checked in ``maps``."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import yaml

from companion.errors import MapError
from companion.yaml_keys import EachKeyOnce

MAX_FILE_BYTES = 2**23
"""About 40,000 buildings; a larger file is more likely the wrong one."""
_DEEPEST = 20
_OUTLINE = re.compile(
    r"(?P<key>^[ \t]+(?:- +)?footprint_m: +)"
    r"(?P<corners>\[\s*\[[-+0-9.eE,\s\[\]]*\]\s*\])(?=[ \t]*$)",
    re.MULTILINE,
)
"""The corners are nearly all of a town's map, and YAML takes 30 us for each number: they are read
as JSON, and set aside where that cannot be."""
_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
"""libyaml's, where PyYAML was built with it, is five times faster."""


class OriginEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """WGS84 position of the map's south-west ground corner."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    """Above mean sea level."""


class ObstacleEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A vertical prism standing on the ground."""

    name: str
    footprint_m: list[tuple[float, float]]
    """Corners as (x east, y north); the outline closes itself."""
    height_m: float


class MapFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A map as written in YAML; lengths in map ENU metres."""

    name: str
    size_m: tuple[float, float, float]
    obstacles: list[ObstacleEntry]
    description: str = ""
    origin: OriginEntry | None = None
    """Where the map lies on earth; or else ``launch_m``."""
    launch_m: tuple[float, float, float] | None = None
    """Where the autopilot's local origin lies on a map without a place on earth."""


def read_map_file(path: Path) -> MapFile:
    """Read a map file and check its keys and types.

    Raises:
        MapError: If the file cannot be read, is not YAML or has other keys or types than
            ``MapFile``. The message says where, without naming the file.
    """
    try:
        return msgspec.convert(_parse(_read(path)), MapFile)
    except msgspec.ValidationError as error:
        problem, _, where = str(error).partition(" - at `$")
        field = where.rstrip("`").lstrip(".")
        problem = problem[:1].lower() + problem[1:]
        raise MapError(f"{field}: {problem}" if field else problem) from error


def _read(path: Path) -> str:
    try:
        with path.open("rb") as file:
            data = file.read(MAX_FILE_BYTES + 1)
    except OSError as error:
        raise MapError((error.strerror or str(error)).lower()) from error
    if len(data) > MAX_FILE_BYTES:
        raise MapError(f"larger than {MAX_FILE_BYTES // 1024} KiB, this is no map")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise MapError(f"not UTF-8 text (byte {error.start})") from error


def _parse(text: str) -> Any:
    outlines: dict[str, Any] = {}
    try:
        brief = _OUTLINE.sub(lambda found: _set_aside(found, outlines), text)
        _refuse_surprises(brief)
        document = yaml.load(brief, _StrictLoader)
    except yaml.MarkedYAMLError as error:
        problem = f"{error.problem}{_place(error.problem_mark)}"
        raise MapError(f"not valid YAML: {problem}") from error
    except yaml.YAMLError as error:
        raise MapError(f"not valid YAML: {' '.join(str(error).split())}") from error
    except RecursionError as error:
        raise MapError("not valid YAML: nested too deeply") from error
    except ValueError as error:  # a date like 2024-13-45
        raise MapError(f"not valid YAML: {error}") from error
    _put_back(document, outlines)
    return document


def _set_aside(found: re.Match[str], outlines: dict[str, Any]) -> str:
    """Keep an outline that JSON can read, and leave its text on as many lines."""
    try:
        outlines[" ".join(found["corners"].split())] = msgspec.json.decode(found["corners"])
    except msgspec.DecodeError:
        return found[0]
    return f"{found['key']}'{found['corners']}'"


def _put_back(document: Any, outlines: Mapping[str, Any]) -> None:
    obstacles = document.get("obstacles") if isinstance(document, dict) else None
    for obstacle in obstacles if isinstance(obstacles, list) else []:
        text = obstacle.get("footprint_m") if isinstance(obstacle, dict) else None
        if isinstance(text, str):
            obstacle["footprint_m"] = outlines.get(" ".join(text.split()), text)


def _refuse_surprises(text: str) -> None:
    """Refuse tags, aliases (a few nested ones stand for a terabyte) and a tower of brackets."""
    depth = 0
    for event in yaml.parse(text, _Loader):
        if isinstance(event, yaml.AliasEvent) or getattr(event, "tag", None) is not None:
            place = _place(event.start_mark)
            raise MapError(f"not valid YAML: aliases and tags are not allowed in a map{place}")
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > _DEEPEST:
            raise MapError("not valid YAML: nested too deeply")


def _place(mark: Any) -> str:
    return "" if mark is None else f" (line {mark.line + 1}, column {mark.column + 1})"


class _StrictLoader(EachKeyOnce, _Loader):  # type: ignore[misc, valid-type]
    """Plain YAML without a key twice."""
