"""Recorded tracks for targets: tables and telemetry logs."""

import csv
import math
from pathlib import Path

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.arrays import FloatArray
from sim.mock.geodesy import METRES_PER_DEGREE
from sim.mock.packet import message_id
from sim.mock.specs import Spec
from sim.mock.tlog import read_frames

COLUMNS = 4


def read_track(spec: Spec, name: str) -> tuple[FloatArray, FloatArray]:
    """Read a track.

    Args:
        spec: What the file belongs to, for messages.
        name: A CSV table of time_s, east_m, north_m, up_m, with or without a heading, or a .tlog
            with GLOBAL_POSITION_INT: the first system that reports a position, in metres from
            its first one.

    Returns:
        Times from zero, shape ``(n,)``, and ENU positions, shape ``(n, 3)``, metres.

    Raises:
        UsageError: If the file cannot be read or holds no track.
    """
    path = Path(name)
    try:
        rows = _from_log(path) if path.suffix == ".tlog" else _from_table(path)
    except (OSError, ValueError) as error:
        raise spec.error(f"cannot read {name}: {error}") from error
    track = np.array(rows, dtype=np.float64)
    if len(rows) < 2 or not np.isfinite(track).all():
        raise spec.error(f"{name} holds no track")
    times_s = track[:, 0] - track[0, 0]
    if (np.diff(times_s) <= 0.0).any():
        raise spec.error(f"{name}: times must rise")
    return times_s, track[:, 1:]


def _from_table(path: Path) -> list[list[float]]:
    with path.open(newline="") as file:
        lines = [line for line in csv.reader(file) if line]
    if lines and not _is_number(lines[0][0]):
        del lines[0]
    for line in lines:
        if len(line) != COLUMNS:
            raise ValueError(f"expected time_s,east_m,north_m,up_m, got {','.join(line)}")
    return [[float(value) for value in line] for line in lines]


def _from_log(path: Path) -> list[list[float]]:
    parser = mavlink.MAVLink(None)
    rows: list[list[float]] = []
    system, first = 0, (0.0, 0.0, 0.0)
    for time_s, frame in read_frames(path):
        if message_id(frame) != mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT:
            continue
        message = parser.decode(bytearray(frame))
        here = message.lat / 1e7, message.lon / 1e7, message.alt / 1e3
        if here[:2] == (0.0, 0.0) or system not in (0, message.get_srcSystem()):
            continue
        if not rows:
            system, first = message.get_srcSystem(), here
        elif time_s <= rows[-1][0]:
            continue
        north = (here[0] - first[0]) * METRES_PER_DEGREE
        east = (here[1] - first[1]) * METRES_PER_DEGREE * math.cos(math.radians(first[0]))
        rows.append([time_s, east, north, here[2] - first[2]])
    return rows


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
