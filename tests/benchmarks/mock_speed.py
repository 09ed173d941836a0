"""Measure the mock vehicle: flights on a virtual clock, and two vehicles on sockets.

``python tests/benchmarks/mock_speed.py`` prints a Markdown table: a thousand flights of a minute in
two processes, each at full PX4 rates with every packet put into bytes and setpoints at 20 Hz, and
the processor time of two mocks that send all they have to one listener. ``flights`` or ``sockets``
measures one of them; a number says how many flights.
"""

import math
import multiprocessing
import socket
import subprocess
import sys
import time

import psutil

from sim.mock.bench import Bench

FLIGHTS = 1000
FLIGHT_S = 60.0
SOCKETS_S = 30.0
OFFBOARD = (176, 1, 6)
ARM = (400, 1)


def fly(number):
    """Fly a minute in a direction of its own; return the packets and bytes sent, of the first."""
    bench = Bench(seed=number)
    bench.run(2.0)
    climb = bench.velocity(0.0, 0.0, -1.0)
    bench.run(0.5, stream=climb)
    assert bench.command(*OFFBOARD) == bench.command(*ARM) == 0
    bench.run(10.0, stream=climb)
    course = 2.0 * math.pi * number / FLIGHTS
    leg = bench.velocity(2.0 * math.cos(course), 2.0 * math.sin(course), 0.0)
    bench.run(FLIGHT_S - bench.time_s, stream=leg)
    assert math.hypot(*bench.vehicle.autopilot.body.position_m[:2]) > 70.0
    packets = [received.packet for received in bench.received] if number == 0 else []
    return len(packets), sum(map(len, packets))


def cpu_s(times):
    return times.user + times.system + times.children_user + times.children_system


def flights(count):
    before, start = cpu_s(psutil.Process().cpu_times()), time.monotonic()
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        sent = pool.map(fly, range(count), chunksize=10)
        pool.close()
        pool.join()
    wall = time.monotonic() - start
    cpu = cpu_s(psutil.Process().cpu_times()) - before
    packets, size = (total / FLIGHT_S for total in sent[0])
    print(
        f"| {count} flights of {FLIGHT_S:.0f} s, two processes | {wall:.0f} s "
        f"({cpu:.0f} s of processor) | 120 s | {packets:.0f} packets, {size / 1e3:.1f} kB "
        "a second of flight |",
        flush=True,
    )


def sockets(seconds):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as here:
        here.bind(("127.0.0.1", 0))
        url = f"udpout:127.0.0.1:{here.getsockname()[1]}"
        mocks = [
            subprocess.Popen(
                [sys.executable, "-m", "sim.mock", "--connect", url, "--sysid", str(sysid)],
                stdout=subprocess.DEVNULL,
            )
            for sysid in (1, 2)
        ]
        here.settimeout(1.0)
        time.sleep(5.0)  # booted
        here.recv(2048)
        watched = [psutil.Process(mock.pid) for mock in mocks]
        before, start = [cpu_s(each.cpu_times()) for each in watched], time.monotonic()
        packets = 0
        while time.monotonic() < start + seconds:
            here.recv(2048)
            packets += 1
        spent = sum(cpu_s(each.cpu_times()) for each in watched) - sum(before)
        for mock in mocks:
            mock.terminate()
            mock.wait()
    print(
        f"| two vehicles on sockets, {packets / seconds:.0f} packets a second | "
        f"{100.0 * spent / seconds:.1f} % of a core together | 25 % | |"
    )


if __name__ == "__main__":
    what = sys.argv[1] if len(sys.argv) > 1 else "all"
    print("| What | Measured | Bar | |\n|---|---|---|---|", flush=True)
    if what != "sockets":
        flights(int(sys.argv[2]) if len(sys.argv) > 2 else FLIGHTS)
    if what != "flights":
        sockets(SOCKETS_S)
