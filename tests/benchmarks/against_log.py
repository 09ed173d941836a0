"""What a session says of a flight beside what the autopilot itself logged of it.

    python tests/benchmarks/against_log.py SESSION LOG

LOG is ArduPilot's DataFlash log (``.bin``) or PX4's (``.ulg``, which needs ``pip install pyulog``).
The two are laid over each other by the autopilot's own clock, ``time_boot_ms``.
"""

import argparse
import json
import sys
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from pymavlink import DFReader
from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.session.tlog import read_tlog

SETPOINT = "SET_POSITION_TARGET_LOCAL_NED"
PX4_OFFBOARD = 14
"""NAVIGATION_STATE_OFFBOARD of vehicle_status."""
COPTER_GUIDED = 4
STILL_S = 3.0
"""What is looked at after the last setpoint."""


@dataclass(slots=True)
class Track:
    """Where the vehicle was: times (s since boot), positions and velocities, local NED."""

    time_s: np.ndarray
    position_ned_m: np.ndarray
    velocity_ned_mps: np.ndarray

    def between(self, start_s: float, end_s: float) -> "Track":
        """Return the part of it."""
        rows = (self.time_s >= start_s) & (self.time_s <= end_s)
        return Track(self.time_s[rows], self.position_ned_m[rows], self.velocity_ned_mps[rows])

    def at(self, time_s: float) -> np.ndarray:
        """Return the position, interpolated, shape ``(3,)``."""
        columns = [np.interp(time_s, self.time_s, self.position_ned_m[:, n]) for n in range(3)]
        return np.array(columns)

    @property
    def length_m(self) -> float:
        """Return the way flown, looked at ten times a second so that noise adds nothing."""
        times_s = np.arange(self.time_s[0], self.time_s[-1], 0.1)
        places_m = np.array([self.at(time_s) for time_s in times_s])
        return float(np.linalg.norm(np.diff(places_m, axis=0), axis=1).sum())

    @property
    def top_mps(self) -> float:
        """Return the greatest speed."""
        return float(np.linalg.norm(self.velocity_ned_mps, axis=1).max())


@dataclass(slots=True)
class Told:
    """What one side tells of a flight."""

    track: Track
    truth: Track | None = None
    """Where a simulator says that it really was."""
    setpoints: list[tuple[float, tuple[float, ...]]] = field(default_factory=list)
    """Time (s since boot) and velocity, local NED."""
    modes: list[tuple[float, bool]] = field(default_factory=list)
    """When it changed, and whether setpoints are obeyed then."""

    def ours(self, near_s: float) -> tuple[float, float]:
        """Return from when to when setpoints were obeyed around a moment."""
        start_s = max(time_s for time_s, obeys in self.modes if obeys and time_s <= near_s + 1.5)
        ends_s = [time_s for time_s, obeys in self.modes if not obeys and time_s > start_s]
        return start_s, min(ends_s, default=float(self.track.time_s[-1]))


def of_session(folder: Path) -> Told:
    """Return what the companion saw and sent, by the autopilot's clock."""
    reader = dialect.MAVLink(None)
    reader.robust_parsing = True
    rows, offsets_s, setpoints, modes = [], [], [], []
    obeyed = None
    for utc_us, frame in read_tlog((folder / "flight.tlog").read_bytes()):
        for message in reader.parse_buffer(frame) or []:
            name, now_s = message.get_type(), utc_us / 1e6
            if name == "LOCAL_POSITION_NED" and message.get_srcComponent() == 1:
                m = message
                rows.append((m.time_boot_ms / 1e3, m.x, m.y, m.z, m.vx, m.vy, m.vz))
                offsets_s.append(now_s - m.time_boot_ms / 1e3)
            elif name == SETPOINT and message.get_srcComponent() == 191:
                setpoints.append((now_s, (message.vx, message.vy, message.vz)))
            elif name == "HEARTBEAT" and message.get_srcComponent() == 1:
                mode = message.custom_mode
                is_px4 = message.autopilot == dialect.MAV_AUTOPILOT_PX4
                obeys = (mode >> 16 & 0xFF) == 6 if is_px4 else mode == COPTER_GUIDED
                if obeys is not obeyed:
                    modes.append((now_s, obeys))
                    obeyed = obeys
    offset_s = float(np.median(offsets_s))  # of the way a message takes, only the usual part
    return Told(
        _track(np.array(rows)),
        setpoints=[(time_s - offset_s, velocity) for time_s, velocity in setpoints],
        modes=[(time_s - offset_s, obeys) for time_s, obeys in modes],
    )


def of_dataflash(path: Path) -> Told:
    """Return what ArduCopter logged: XKF1, SIM2, MODE, and GUIP, a row for every setpoint."""
    log = DFReader.DFReader_binary(str(path))
    rows, truth, setpoints, modes = [], [], [], []
    while (m := log.recv_match(type=["XKF1", "SIM2", "GUIP", "MODE"])) is not None:
        name, time_s = m.get_type(), m.TimeUS / 1e6
        if name == "XKF1" and m.C == 0:
            rows.append((time_s, m.PN, m.PE, m.PD, m.VN, m.VE, m.VD))
        elif name == "SIM2":
            truth.append((time_s, m.PN, m.PE, m.PD, m.VN, m.VE, m.VD))
        elif name == "GUIP":
            setpoints.append((time_s, (m.vX, m.vY, -m.vZ)))
        elif name == "MODE":
            modes.append((time_s, m.ModeNum == COPTER_GUIDED))
    return Told(_track(np.array(rows)), _track(np.array(truth)) if truth else None,
                setpoints, modes)  # fmt: skip


def of_ulog(path: Path) -> Told:
    """Return what PX4 logged: vehicle_local_position, its ground truth, vehicle_status."""
    try:
        from pyulog import ULog
    except ImportError:
        sys.exit("a .ulg needs: pip install pyulog")
    wanted = ["vehicle_local_position", "vehicle_local_position_groundtruth", "vehicle_status"]
    data = {each.name: each.data for each in ULog(str(path), wanted).data_list}

    def track(name: str) -> Track | None:
        if name not in data:
            return None
        table, columns = data[name], ("x", "y", "z", "vx", "vy", "vz")
        time_s = table["timestamp"] / 1e6
        return _track(np.column_stack([time_s, *(table[column] for column in columns)]))

    status, modes = data["vehicle_status"], []
    for time_us, state in zip(status["timestamp"], status["nav_state"], strict=True):
        if not modes or modes[-1][1] is not bool(state == PX4_OFFBOARD):
            modes.append((time_us / 1e6, bool(state == PX4_OFFBOARD)))
    known = track("vehicle_local_position")
    assert known is not None
    return Told(known, track("vehicle_local_position_groundtruth"), modes=modes)


def _track(rows: np.ndarray) -> Track:
    return Track(rows[:, 0], rows[:, 1:4], rows[:, 4:7])


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("session", type=Path)
    parser.add_argument("log", type=Path)
    arguments = parser.parse_args()
    summary = json.loads((arguments.session / "summary.json").read_text())
    said = of_session(arguments.session)
    read = of_ulog if arguments.log.suffix == ".ulg" else of_dataflash
    logged = read(arguments.log)

    run_s = (float(said.track.time_s[0]), float(said.track.time_s[-1]))
    log_s = (float(logged.track.time_s[0]), float(logged.track.time_s[-1]))
    if run_s[0] < log_s[0] - STILL_S or run_s[1] > log_s[1] + STILL_S:
        sys.exit(
            f"the log is of another flight: {log_s[0]:.0f} to {log_s[1]:.0f} s after boot, "
            f"the session {run_s[0]:.0f} to {run_s[1]:.0f} s"
        )
    flown, seen = logged.track.between(*run_s), said.track
    apart_m = np.array([logged.track.at(t) for t in seen.time_s]) - seen.position_ned_m
    print(f"{arguments.session.name}: {summary['outcome']}, {summary['reason']}")
    rows = [
        ("way flown in the air (m)", summary["distance_flown_m"], flown.length_m),
        ("greatest speed (m/s)", summary["max_speed_mps"], flown.top_mps),
        ("LOCAL_POSITION_NED and the log apart, median (m)", None,
         float(np.median(np.linalg.norm(apart_m, axis=1)))),
    ]  # fmt: skip
    moving = [time_s for time_s, velocity in said.setpoints if any(velocity)]
    if moving:
        ours = said.ours(moving[0])
        theirs = logged.ours(moving[0])
        rows += [
            ("seconds in OFFBOARD / GUIDED", ours[1] - ours[0], theirs[1] - theirs[0]),
            ("it ended (s after boot)", ours[1], theirs[1]),
            ("setpoints", len(said.setpoints), _count(logged.setpoints, run_s)),
            ("setpoints after it ended", _count(said.setpoints, (theirs[1], np.inf)),
             _count(logged.setpoints, (theirs[1] + 0.01, theirs[1] + STILL_S))),
        ]  # fmt: skip
    if logged.truth is not None:
        true_m = np.array([logged.truth.at(t) for t in flown.time_s]) - flown.position_ned_m
        wander_m = true_m - np.median(true_m, axis=0)
        rows.append(("estimate and truth apart, greatest (m)", None,
                     float(np.linalg.norm(wander_m, axis=1).max())))  # fmt: skip
    print(f"{'':50}{'companion':>12}{'autopilot':>12}")
    for name, ours_is, theirs_is in rows:
        print(f"{name:50}{_word(ours_is):>12}{_word(theirs_is):>12}")


def _count(setpoints: list[tuple[float, tuple[float, ...]]], span_s: tuple[float, float]) -> object:
    if not setpoints:
        return None
    return sum(span_s[0] <= time_s <= span_s[1] for time_s, _ in setpoints)


def _word(value: object) -> str:
    if value is None:
        return "-"
    return f"{value:.2f}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    main()
