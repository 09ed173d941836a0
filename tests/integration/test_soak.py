"""Hours of flight: what the program takes of the machine must not grow.

``pytest -m slow tests/integration/test_soak.py -s`` flies for ``COMPANION_SOAK_MINUTES`` (10) of
real time in front of a mock vehicle that lives four times as fast, and prints the figures. PX4 then
gives up after 250 ms: whoever flies at the lowest priority beside other work is stood down.
"""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

MINUTES = float(os.environ.get("COMPANION_SOAK_MINUTES", "10"))
MOCK_SPEED = 4
SAMPLE_S = 5.0
PAGE_MIB = os.sysconf("SC_PAGE_SIZE") / 2**20
TICKS_PER_S = os.sysconf("SC_CLK_TCK")


def figures(process_id):
    """Return resident memory (MiB), processor time (s), open files and threads of a process."""
    proc = Path(f"/proc/{process_id}")
    resident_mib = int((proc / "statm").read_text().split()[1]) * PAGE_MIB
    stat = (proc / "stat").read_text().rsplit(")", 1)[1].split()
    processor_s = (int(stat[11]) + int(stat[12])) / TICKS_PER_S
    return resident_mib, processor_s, len(list((proc / "fd").iterdir())), int(stat[17])


def children(process_id):
    """Return the processes that one has started."""
    listed = Path(f"/proc/{process_id}/task/{process_id}/children").read_text()
    return [int(child) for child in listed.split()]


def charging(duration_s):
    """Return what fills the mock's battery, good for twenty minutes, again and again."""
    for at_s in range(600, int(duration_s) + 600, 600):
        yield from ("--fault", f"t={at_s},kind=battery_low,level=1")


@pytest.mark.slow
@pytest.mark.timeout(60.0 * MINUTES + 120.0)
def test_nothing_grows(constant_actor, tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    mock = subprocess.Popen(
        [
            *(sys.executable, "-m", "sim.mock", "--autopilot", "px4", "--map", "env1"),
            *("--connect", f"udpout:127.0.0.1:{port}", "--speed", str(MOCK_SPEED)),
            *("--target", "kind=circle,sysid=42,at=60:12:6,radius=6,speed=1"),
            *charging(MOCK_SPEED * 60.0 * MINUTES),
            "--exit-with-parent",
        ],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    flies_away = constant_actor((-0.5, 0.0, 1.0))  # from the target, and along the fence for ever
    companion = subprocess.Popen(
        [
            *(sys.executable, "-m", "companion.cli", "run", "--json", "--map", "env1"),
            *("--connect", f"udp:127.0.0.1:{port}", "--actor", str(flies_away)),
            *("--target-sysid", "42", "--arm", "--takeoff", "6", "--engage"),
            *("--record", str(tmp_path / "sessions")),
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    samples, recorder_mib = [], []
    try:
        while companion.poll() is None and not children(companion.pid):
            time.sleep(0.1)  # on a crowded machine it takes its time to start
        end_s = time.monotonic() + 60.0 * MINUTES
        while time.monotonic() < end_s:
            time.sleep(SAMPLE_S)
            assert companion.poll() is None, companion.stdout.read()
            samples.append(figures(companion.pid))
            recorder_mib += [max(figures(child)[0] for child in children(companion.pid))]
        companion.send_signal(signal.SIGTERM)
        summary = json.loads(companion.communicate(timeout=60)[0])
    finally:
        for process in (companion, mock):
            process.kill()
            process.wait()
        companion.stdout.close()

    quarter = len(samples) // 4
    resident_mib = [sample[0] for sample in samples]
    warm_mib, last_mib = max(resident_mib[quarter : 2 * quarter]), max(resident_mib[-quarter:])
    recorder_grown_mib = max(recorder_mib[-quarter:]) - max(recorder_mib[quarter : 2 * quarter])
    processor_s = samples[-1][1] - samples[0][1]
    recorded_mib = (
        sum(path.stat().st_size for path in (tmp_path / "sessions").rglob("*") if path.is_file())
        / 2**20
    )
    print(
        f"\n{MINUTES:g} min at x{MOCK_SPEED}: resident {warm_mib:.1f} MiB in the second quarter, "
        f"{last_mib:.1f} in the last; the recorder grew by {recorder_grown_mib:.1f} MiB; "
        f"{100 * processor_s / (SAMPLE_S * (len(samples) - 1)):.1f} % "
        f"of a core; files {samples[quarter][2]} -> {samples[-1][2]}, threads {samples[-1][3]}; "
        f"{recorded_mib:.0f} MiB recorded; {summary}"
    )
    assert summary["outcome"] == "stopped"
    assert last_mib - warm_mib < 5.0
    assert recorder_grown_mib < 10.0
    assert samples[-1][2] == samples[quarter][2]
    assert samples[-1][3] == samples[quarter][3]
