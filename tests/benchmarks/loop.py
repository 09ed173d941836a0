"""Measure a whole ``companion run`` against the mock: latency, jitter, processor, memory, start.

``python tests/benchmarks/loop.py`` prints two Markdown tables. A bare UDP echo, a loop of mavutil
and one of MAVSDK (``answers.py``) run before and after in the same conditions, so that a busy
machine shows in all of them.
"""

import json
import os
import platform
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import psutil
from answers import round_trips_ms

SECONDS = 30.0
RATE_HZ = 50
OTHERS = ("echo", "mavutil", "mavsdk")
PYTHON = [sys.executable, "-m"]


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def others_ms(seconds):
    """Return p50 and p99 of what a bare echo, mavutil and MAVSDK take to answer a position."""
    found = {}
    for name in OTHERS:
        port = free_port()
        other = subprocess.Popen(
            [sys.executable, str(Path(__file__).with_name("answers.py")), name, str(port)],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            found[name] = round_trips_ms(port, seconds, RATE_HZ)
        finally:
            other.kill()
            other.wait()
    return found


def first_heartbeat_s():
    """Return how long after its start a companion sends its first frame."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        listener.settimeout(30.0)
        url = f"udpout:127.0.0.1:{listener.getsockname()[1]}"
        start = time.perf_counter()
        process = subprocess.Popen(
            [*PYTHON, "companion.cli", "run", "--connect", url],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            listener.recv(300)
            return time.perf_counter() - start
        finally:
            process.kill()
            process.wait()


def fly(folder):
    """Fly towards a target for ``SECONDS`` and return the summary, processor share and memory."""
    port = free_port()
    mock = subprocess.Popen(
        [*PYTHON, "sim.mock", "--connect", f"udpout:127.0.0.1:{port}", "--map", "env1"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    run = subprocess.Popen(
        [
            *PYTHON, "companion.cli", "run", "--connect", f"udp:127.0.0.1:{port}",
            "--map", "env1", "--target", "85,80,25", "--rate-hz", str(RATE_HZ), "--v-max", "1.5",
            "--arm", "--takeoff", "10", "--engage", "--record", folder, "--json",
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )  # fmt: skip
    try:
        engaged = threading.Event()
        threading.Thread(
            target=lambda: [engaged.set() for line in run.stderr if "engaged" in line], daemon=True
        ).start()
        engaged.wait(60.0)
        process = psutil.Process(run.pid)
        before, start = process.cpu_times(), time.monotonic()
        time.sleep(SECONDS)
        after, memory = process.cpu_times(), process.memory_info().rss
        share = (after.user + after.system - before.user - before.system) / (
            time.monotonic() - start
        )
        run.send_signal(2)
        summary = json.loads(run.stdout.read())
        run.wait(30.0)
        return summary, 100 * share, memory / 2**20
    finally:
        for process in (run, mock):
            process.kill()
            process.wait()


def main():
    with tempfile.TemporaryDirectory() as folder:
        before = others_ms(10.0)
        summary, share, memory_mib = fly(folder)
        after = others_ms(10.0)
        rrd = sum(path.stat().st_size for path in Path(folder).rglob("*.rrd"))
    starts = [first_heartbeat_s() for _ in range(3)]
    others = {name: (before[name] + after[name]) / 2 for name in OTHERS}
    load = os.getloadavg()[0]
    rows = [
        ("latency p50", f"{summary['latency_p50_ms']:.2f} ms", "1 ms",
         f"{summary['latency_p50_ms'] / others['echo'][0]:.1f} x a bare echo"),
        ("latency p99", f"{summary['latency_p99_ms']:.2f} ms", "5 ms",
         f"{summary['latency_p99_ms'] / others['echo'][1]:.1f} x a bare echo"),
        ("setpoint jitter p99", f"{summary['jitter_p99_ms']:.2f} ms", "5 ms (20 Hz)", ""),
        ("setpoint rate", f"{summary['setpoint_rate_hz']:.2f} Hz", f"{RATE_HZ} Hz",
         f"{summary['late_ticks']} late ticks of {summary['setpoints_sent']}"),
        ("companion process", f"{share:.1f} % of a core", "10 %", ""),
        ("memory", f"{memory_mib:.0f} MiB", "200 MB", ""),
        ("first heartbeat", f"{statistics.median(starts):.2f} s", "1.5 s", "median of 3 starts"),
        ("recording", f"{rrd / 2**20 / summary['duration_s'] * 60:.1f} MiB a minute", "3.3", ""),
    ]  # fmt: skip
    print(f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}, ")
    print(f"load average {load:.1f}; {RATE_HZ} Hz, recording on, {SECONDS:.0f} s under way.\n")
    print("| What | Measured | Bar | |\n|---|---|---|---|")
    for row in rows:
        print("| " + " | ".join(row) + " |")
    print("\n| Position in, velocity out | p50 | p99 |\n|---|---|---|")
    whole = np.array([summary["latency_p50_ms"], summary["latency_p99_ms"]])
    for name, trip in [*others.items(), ("companion: policy, shield, recording", whole)]:
        print(f"| {name} | {trip[0]:.2f} ms | {trip[1]:.2f} ms |")


if __name__ == "__main__":
    main()
