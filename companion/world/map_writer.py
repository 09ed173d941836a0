"""Maps to files that ``load_map`` reads, and people too."""

import json
import os
import tempfile
import textwrap
from pathlib import Path

from companion.errors import MapError, UsageError
from companion.world.map_file import MAX_FILE_BYTES
from companion.world.maps import Map

_WIDTH = 100


def map_text(city: Map, comment: str) -> str:
    """Return a map as YAML, lengths to the centimetre.

    Args:
        city: A map with a place on earth.
        comment: What to write above it.

    Raises:
        MapError: If the file would be larger than one may be.
    """
    if city.origin is None:
        raise MapError(
            f"map {city.name} has no origin: only maps with a place on earth are written"
        )
    lines = [
        *(f"# {line}" for line in textwrap.wrap(comment, _WIDTH - 2)),
        f"name: {_quoted(city.name)}",
        f"description: {_quoted(city.description)}",
        f"size_m: [{', '.join(_length(side) for side in city.size_m)}]",
        f"origin: {{latitude_deg: {city.origin.latitude_deg:.8f}, "
        f"longitude_deg: {city.origin.longitude_deg:.8f}, "
        f"altitude_m: {_length(city.origin.altitude_m)}}}",
        "obstacles:",
    ]
    for name, footprint_m, height_m in zip(
        city.obstacle_names, city.footprints_m, city.heights_m, strict=True
    ):
        corners = ", ".join(f"[{_length(east)}, {_length(north)}]" for east, north in footprint_m)
        lines += [
            f"  - name: {_quoted(name)}",
            *textwrap.wrap(
                f"footprint_m: [{corners}]",
                _WIDTH,
                initial_indent=" " * 4,
                subsequent_indent=" " * 6,
                break_long_words=False,
                break_on_hyphens=False,
            ),
            f"    height_m: {_length(height_m)}",
        ]
    text = "\n".join(lines) + "\n"
    size = len(text.encode())
    if size > MAX_FILE_BYTES:
        raise MapError(
            f"the map would take {size // 1024} KiB ({len(city.obstacles)} obstacles) and a map "
            f"file has at most {MAX_FILE_BYTES // 1024}: choose a smaller --box or a larger "
            "--tolerance"
        )
    return text


def write_text(path: Path, text: str) -> None:
    """Write a file whole or not at all, over what was there.

    Raises:
        UsageError: If it cannot be written.
    """
    try:
        handle, draft = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        try:
            with os.fdopen(handle, "w", encoding="utf-8") as file:
                file.write(text)
            Path(draft).chmod(0o644)
            Path(draft).replace(path)
        except BaseException:
            Path(draft).unlink(missing_ok=True)
            raise
    except OSError as error:
        raise UsageError(f"cannot write {path}: {error.strerror or error}") from error


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)


def _length(length_m: float) -> str:
    return f"{length_m:.2f}".rstrip("0").rstrip(".")
