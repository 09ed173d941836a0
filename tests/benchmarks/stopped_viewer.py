"""Does flight notice the live viewer? ``python tests/benchmarks/stopped_viewer.py [ROUNDS]``.

One slow flight against the mock with ``--rerun serve``. In each round, in random order: no viewer,
a viewer that watches, and a viewer that was stopped in mid-flight with SIGSTOP. Setpoints are
taken from the session's ``flight.tlog``; jitter is how far the interval between two of them is
from nominal. Rounds are compared with themselves, so that what else the machine does cancels, and
resampled for the 95 % intervals.
"""

import os
import platform
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.session.tlog import read_tlog
from companion.session.viewer import free_port, viewer_binary

RATE_HZ = 50
BLOCK_S = 10.0
SETTLE_S = 1.5
ATTACH_S = 5.0
STATES = ("no viewer", "watching", "stopped")
SAMPLES = 4000


def begin_flight(folder):
    """Start the flight; return it and the address of its live view."""
    run = subprocess.Popen(
        [
            *(sys.executable, "-m", "companion.cli", "run", "--connect", "mock:px4"),
            *("--map", "free", "--target", "95,95,40", "--v-max", "0.1"),
            *("--rate-hz", str(RATE_HZ), "--arm", "--takeoff", "10", "--engage"),
            *("--rerun", "serve", "--record", folder),
        ],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    address, said = None, []
    for line in run.stderr:
        said.append(line)
        if found := re.search(r"rerun --connect (\S+)", line):
            address = found.group(1)
        if "engaged: " in line and address is not None:
            threading.Thread(target=lambda: said.extend(run.stderr), daemon=True).start()
            return run, address
    raise SystemExit("".join(said))


def block(state, address):
    """Hold one state for a while; return when it held, seconds since 1970."""
    viewer = None
    if state != "no viewer":
        viewer = subprocess.Popen(
            [
                *(str(viewer_binary()), "--headless", "--port", str(free_port())),
                *("--bind", "127.0.0.1", "--connect", address),
            ],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        time.sleep(ATTACH_S)
        if viewer.poll() is not None:
            raise SystemExit("the viewer did not start: is there a Vulkan driver?")
        if state == "stopped":
            os.kill(viewer.pid, signal.SIGSTOP)
    try:
        time.sleep(SETTLE_S)
        begin_s = time.time()
        time.sleep(BLOCK_S)
        return begin_s, time.time()
    finally:
        if viewer is not None:
            viewer.kill()
            viewer.wait()


def setpoint_times_s(tlog):
    """Return when each setpoint was sent, seconds since 1970, in order."""
    wanted = dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED
    return np.array(
        [
            utc_us * 1e-6
            for utc_us, frame in read_tlog(tlog.read_bytes())
            if int.from_bytes(frame[7:10], "little") == wanted
        ]
    )


def jitters_ms(times_s, begin_s, end_s):
    within = times_s[(times_s >= begin_s) & (times_s < end_s)]
    return 1e3 * np.abs(np.diff(within) - 1.0 / RATE_HZ)


def interval(blocks, measure, rng):
    """Return the difference to ``no viewer`` and its 95 % interval, rounds resampled."""
    first, second = blocks

    def difference(rounds):
        return measure(np.concatenate([second[index] for index in rounds])) - measure(
            np.concatenate([first[index] for index in rounds])
        )

    everything = difference(range(len(first)))
    drawn = [difference(rng.integers(0, len(first), len(first))) for _ in range(SAMPLES)]
    return everything, *np.percentile(drawn, (2.5, 97.5))


def p99(values):
    return float(np.percentile(values, 99))


def main():
    rounds = int(sys.argv[1]) if len(sys.argv) > 1 else 12
    rng = np.random.default_rng(1)
    spans = {state: [] for state in STATES}
    with tempfile.TemporaryDirectory() as folder:
        run, address = begin_flight(folder)
        try:
            for _ in range(rounds):
                for state in rng.permutation(STATES):
                    spans[state].append(block(state, address))
        finally:
            run.send_signal(signal.SIGINT)
            run.wait(60.0)
        (tlog,) = Path(folder).glob("*/flight.tlog")
        times_s = setpoint_times_s(tlog)
    blocks = {state: [jitters_ms(times_s, *span) for span in spans[state]] for state in STATES}
    load = os.getloadavg()[0]
    print(f"{platform.machine()}, {os.cpu_count()} cores, load average {load:.1f}; {RATE_HZ} Hz,")
    print(f"{rounds} rounds of {BLOCK_S:.0f} s each.\n")
    print("| Viewer | Setpoints | Jitter p50 | p99 | Largest | Late by a tick |")
    print("|---|---|---|---|---|---|")
    for state in STATES:
        all_ms = np.concatenate(blocks[state])
        print(
            f"| {state} | {len(all_ms)} | {np.median(all_ms):.3f} ms | {p99(all_ms):.2f} ms "
            f"| {all_ms.max():.1f} ms | {(all_ms > 1e3 / RATE_HZ).sum()} |"
        )
    print("\n| Against no viewer, 95 % interval | Jitter p50 | Jitter p99 |\n|---|---|---|")
    for state in STATES[1:]:
        pair = blocks["no viewer"], blocks[state]
        cells = [
            "{:+.3f} ms [{:+.3f}, {:+.3f}]".format(*interval(pair, measure, rng))
            for measure in (np.median, p99)
        ]
        print(f"| {state} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
