"""Fly for an hour of real time: ``python tests/benchmarks/soak.py [MINUTES]``.

The shipped actor pursues a target that is always faster, 20 times a second, with recording on.
Once a minute it prints what the flying process and its recorder take of the machine, and from
what left for the wire (``flight.tlog``) the longest gap between two setpoints. Beside them stand
the load of the machine and how long the flying process was ready to run and got no processor:
for the minute, and in the seconds round each gap that is longer than it may be.
"""

import itertools
import json
import os
import signal
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import psutil
from loop import PYTHON, free_port

SETPOINT = 84
"""SET_POSITION_TARGET_LOCAL_NED."""
MAX_GAP_MS = 200.0
COLUMNS = (
    "minute", "load", "MiB", "files", "threads", "core %", "starved ms", "recorder MiB",
    "recorder core %", "setpoints", "longest gap ms", "too long", "folder MiB",
)  # fmt: skip


class SetpointTimes:
    """Reads a .tlog that still grows; MAVLink 2 without signatures."""

    def __init__(self, path):
        self._file = path.open("rb")
        self._rest = b""

    def new_s(self):
        """Return the times of the setpoints that were added since the last call."""
        data, times_s, start = self._rest + self._file.read(), [], 0
        while len(data) >= start + 20:
            end = start + 8 + 12 + data[start + 9]
            if len(data) < end:
                break
            if int.from_bytes(data[start + 15 : start + 18], "little") == SETPOINT:
                times_s.append(struct.unpack_from(">Q", data, start)[0] * 1e-6)
            start = end
        self._rest = data[start:]
        return times_s


def charging(minutes):
    """Return what fills the mock's battery, good for twenty minutes, again and again."""
    for at_s in range(600, 60 * minutes, 600):
        yield from ("--fault", f"t={at_s},kind=battery_low,level=1")


def starved_ms(process_id):
    """Return how long a process has waited for a processor that others had."""
    return int(Path(f"/proc/{process_id}/schedstat").read_text().split()[1]) / 1e6


def busy_s(process):
    times = process.cpu_times()
    return times.user + times.system


def main():
    minutes = int(sys.argv[1]) if len(sys.argv) > 1 else 60
    port = free_port()
    with tempfile.TemporaryDirectory() as folder:
        mock = subprocess.Popen(
            [
                *(*PYTHON, "sim.mock", "--connect", f"udpout:127.0.0.1:{port}", "--map", "env1"),
                *("--target", "kind=circle,sysid=42,at=50:50:90,radius=38,speed=6"),
                *charging(minutes),
            ],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        run = subprocess.Popen(
            [
                *(*PYTHON, "companion.cli", "run", "--connect", f"udp:127.0.0.1:{port}"),
                *("--map", "env1", "--target-sysid", "42", "--v-max", "3"),
                *("--arm", "--takeoff", "20", "--engage", "--record", folder, "--json"),
            ],
            stdout=subprocess.PIPE,
            text=True,
        )
        try:
            watch(run, Path(folder), minutes)
            run.send_signal(signal.SIGTERM)
            print(json.dumps(json.loads(run.stdout.read()), indent=1))
            run.wait(60.0)
        finally:
            for process in (run, mock):
                process.kill()
                process.wait()


def watch(run, folder, minutes):
    """Print a row a minute, as a Markdown table."""
    while not (found := list(folder.rglob("flight.tlog"))):
        time.sleep(0.5)
        if run.poll() is not None:
            raise SystemExit(f"the run has ended: {run.stdout.read()}")
    setpoints, last_s = SetpointTimes(found[0]), []
    pilot = psutil.Process(run.pid)
    recorder = max(pilot.children(recursive=True), key=lambda child: child.memory_info().rss)
    print("| " + " | ".join(COLUMNS) + " |\n|" + "---|" * len(COLUMNS))
    before = (busy_s(pilot), busy_s(recorder), starved_ms(run.pid), time.monotonic())
    for minute in range(1, minutes + 1):
        starved = []
        while time.monotonic() < before[3] + 60.0:
            time.sleep(1.0)
            if run.poll() is not None:
                raise SystemExit(f"the run has ended: {run.stdout.read()}")
            starved.append((time.time(), starved_ms(run.pid)))
        now = (busy_s(pilot), busy_s(recorder), starved_ms(run.pid), time.monotonic())
        spent = [b - a for a, b in zip(before, now, strict=True)]
        times_s = last_s + setpoints.new_s()
        gaps_ms = [1e3 * (b - a) for a, b in itertools.pairwise(times_s)]
        long = [number for number, gap_ms in enumerate(gaps_ms) if gap_ms > MAX_GAP_MS]
        size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
        row = (
            minute, f"{os.getloadavg()[0]:.1f}", f"{pilot.memory_info().rss / 2**20:.1f}",
            pilot.num_fds(), pilot.num_threads(), f"{100 * spent[0] / spent[3]:.1f}",
            f"{spent[2]:.0f}", f"{recorder.memory_info().rss / 2**20:.1f}",
            f"{100 * spent[1] / spent[3]:.1f}", len(gaps_ms), f"{max(gaps_ms, default=0.0):.0f}",
            len(long), f"{size / 2**20:.1f}",
        )  # fmt: skip
        print("| " + " | ".join(str(value) for value in row) + " |", flush=True)
        for number in long:
            begin_s, end_s = times_s[number] - 1.0, times_s[number + 1] + 1.0
            near_ms = [ms for at_s, ms in starved if begin_s <= at_s <= end_s]
            waited_ms = near_ms[-1] - near_ms[0] if near_ms else float("nan")
            print(f"a gap of {gaps_ms[number]:.0f} ms; starved for {waited_ms:.0f} ms round it")
        last_s, before = times_s[-1:], now


if __name__ == "__main__":
    main()
