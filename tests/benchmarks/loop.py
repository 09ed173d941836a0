"""Measure a whole ``companion run`` against the mock: latency, jitter, processor, memory, start.

``python tests/benchmarks/loop.py`` prints a Markdown table. A bare UDP echo runs before and after
in the same conditions, so that a busy machine shows in both.
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

SECONDS = 30.0
RATE_HZ = 50
PYTHON = [sys.executable, "-m"]


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def echo_ms(seconds):
    """Return p50 and p99 of a round trip of 65 bytes to another process, 50 a second."""
    port = free_port()
    code = (
        "import socket\ns=socket.socket(socket.AF_INET,socket.SOCK_DGRAM)\n"
        f"s.bind(('127.0.0.1',{port}))\nwhile True:\n d,a=s.recvfrom(99)\n s.sendto(d,a)"
    )
    other = subprocess.Popen([sys.executable, "-c", code])
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as here:
            here.settimeout(1.0)
            time.sleep(0.5)
            trips = []
            start = time.monotonic()
            for k in range(int(seconds * RATE_HZ)):
                time.sleep(max(0.0, start + k / RATE_HZ - time.monotonic()))
                sent = time.perf_counter()
                here.sendto(bytes(65), ("127.0.0.1", port))
                here.recv(99)
                trips.append(1e3 * (time.perf_counter() - sent))
    finally:
        other.kill()
        other.wait()
    return np.percentile(trips, [50, 99])


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
        echo_before = echo_ms(5.0)
        summary, share, memory_mib = fly(folder)
        echo_after = echo_ms(5.0)
        rrd = sum(path.stat().st_size for path in Path(folder).rglob("*.rrd"))
    starts = [first_heartbeat_s() for _ in range(3)]
    echo = (echo_before + echo_after) / 2
    load = os.getloadavg()[0]
    rows = [
        ("latency p50", f"{summary['latency_p50_ms']:.2f} ms", "1 ms",
         f"{summary['latency_p50_ms'] / echo[0]:.1f} x a bare echo ({echo[0]:.2f} ms)"),
        ("latency p99", f"{summary['latency_p99_ms']:.2f} ms", "5 ms",
         f"{summary['latency_p99_ms'] / echo[1]:.1f} x a bare echo ({echo[1]:.2f} ms)"),
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


if __name__ == "__main__":
    main()
