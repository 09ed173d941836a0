"""Map files: YAML from people, read into typed values. What they mean is checked in ``maps``."""

from pathlib import Path
from typing import Any

import msgspec
import yaml

from companion.errors import MapError

MAX_FILE_BYTES = 2**20
"""About 10,000 buildings; YAML is slow, and a larger file is more likely the wrong one."""


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
    try:
        return yaml.load(text, _StrictLoader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        where = "" if mark is None else f" (line {mark.line + 1}, column {mark.column + 1})"
        raise MapError(f"not valid YAML: {error.problem}{where}") from error
    except yaml.YAMLError as error:
        raise MapError(f"not valid YAML: {' '.join(str(error).split())}") from error
    except RecursionError as error:
        raise MapError("not valid YAML: nested too deeply") from error
    except ValueError as error:  # a date like 2024-13-45
        raise MapError(f"not valid YAML: {error}") from error


class _StrictLoader(yaml.SafeLoader):
    """Plain YAML: no key twice, no tags, no aliases (a few nested ones stand for a terabyte)."""

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        event: Any = self.peek_event()  # type: ignore[no-untyped-call]
        if isinstance(event, yaml.AliasEvent) or event.tag is not None:
            raise yaml.composer.ComposerError(
                None, None, "aliases and tags are not allowed in a map", event.start_mark
            )
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if isinstance(key, str) and key in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f"key {key} appears twice", key_node.start_mark
                )
            seen.add(str(key))
        return super().construct_mapping(node, deep)
