"""Measure what a recording costs: ``python tests/benchmarks/recording.py [MINUTES]``.

A synthetic flight round env1 with the observation of layout ``rays``, at 20 Hz with rates and
events, goes through the recorder's own output in the portions of a real flight (a second each),
is rewritten as at the end of a session, and opened in a viewer without a window. Prints a
Markdown table: bytes, rows, the processor time of the recorder for the time flown, and how long
the viewer takes to open it.
"""

import math
import os
import platform
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import psutil
from rerun.chunk import RrdReader
from rerun.experimental import ViewerClient

from companion.errors import CompanionError
from companion.policy.observation import LAYOUTS, build_observation
from companion.session.folder import RECORDING
from companion.session.picture import shoot_settled
from companion.session.records import (
    ActorRecord,
    Event,
    SessionEnd,
    SessionStart,
    Tick,
    VehicleRecord,
    map_record,
)
from companion.session.streams import file_output
from companion.session.summary import Summary
from companion.session.viewer import headless_viewer, optimize
from companion.vehicle import Severity
from companion.world.maps import load_map

RATE_HZ = 20
CITY = load_map("env1")
LAYOUT = LAYOUTS["rays"]
MESSAGES = ("HEARTBEAT", "LOCAL_POSITION_NED", "ATTITUDE", "SYS_STATUS", "ESTIMATOR_STATUS")
START = SessionStart(
    session_id="an-hour",
    start_utc_us=1_795_356_187_000_000,
    map=map_record(CITY),
    actor=ActorRecord("flight", "9f" * 32, LAYOUT.name, list(LAYOUT.columns)),
    vehicle=VehicleRecord(1, "px4", "1.18.0"),
    config={},
    v_max_mps=5.0,
    margin_m=2.0,
    arrival_radius_m=5.0,
)


def second(number, rng):
    """Return the records of one second: round the middle of the map, over and under the roofs."""
    records = []
    for index in range(RATE_HZ):
        t = number + index / RATE_HZ
        turn = 0.1 * t
        place = np.array(
            [50 + 38 * math.cos(turn), 50 + 38 * math.sin(turn), 40 + 15 * math.sin(0.07 * t)]
        )
        target = np.array([50 + 30 * math.sin(0.03 * t), 50 + 20 * math.cos(0.05 * t), 95.0])
        velocity = np.array([-3.8 * math.sin(turn), 3.8 * math.cos(turn), math.cos(0.07 * t)])
        velocity += rng.normal(0.0, 0.05, 3)
        observation = build_observation(
            LAYOUT, map=CITY, position_enu_m=place, velocity_enu_mps=velocity, target_enu_m=target
        )
        records.append(
            Tick(
                time_s=t,
                position_enu_m=place.tolist(),
                velocity_enu_mps=velocity.tolist(),
                attitude_rad=[0.1 * math.sin(t), 0.1 * math.cos(t), turn],
                target_enu_m=target.tolist(),
                target_velocity_enu_mps=[0.9 * math.cos(0.03 * t), 0.0, 0.0],
                target_tier="fresh",
                observation=observation.tolist(),
                action=rng.uniform(-1.0, 1.0, 3).tolist(),
                spherical=rng.uniform(0.0, 3.0, 3).tolist(),
                proposed_enu_mps=(velocity + rng.normal(0.0, 0.3, 3)).tolist(),
                safe_enu_mps=(velocity + rng.normal(0.0, 0.2, 3)).tolist(),
                clearance_m=float(CITY.obstacles.signed_distance_m(place)),
                distance_m=float(np.linalg.norm(target - place)),
                intervened=number % 20 < 2,
                shield_reason="obstacle" if number % 60 == 0 else "",
                supervisor="engaged",
                mode="OFFBOARD",
                armed=True,
                battery_fraction=max(0.0, 1.0 - t / 4000.0),
                link_age_s=t % 1.0,
                position_age_s=float(rng.uniform(0.0, 0.03)),
                target_age_s=float(rng.uniform(0.0, 0.2)),
                latency_ms=float(rng.gamma(3.0, 0.3)),
                lateness_ms=float(rng.gamma(1.0, 0.2)),
                rates_hz=dict.fromkeys(MESSAGES, 10.0 + rng.normal()) if index == 0 else None,
            )
        )
    if number % 20 == 0:
        records.append(Event(float(number), Severity.INFO, "companion", "engaged: resumed"))
    return records


def record(folder, minutes):
    """Record a flight; return processor seconds, and bytes before and after the rewriting."""
    rng = np.random.default_rng(1)
    output = file_output(folder, footer=False)
    output.write(START)
    spent_s = 0.0
    for number in range(round(60 * minutes)):
        records = second(number, rng)
        begin_s = time.process_time()
        for one in records:
            output.write(one)
        output.flush(float(number + 1))
        spent_s += time.process_time() - begin_s
    output.write(SessionEnd(Summary(outcome="ended", reason="an hour", exit_code=0)))
    output.close()
    raw = folder / RECORDING
    rewritten = folder / "rewritten.rrd"
    before, begin_s = os.times(), time.perf_counter()
    if not optimize(raw, rewritten):
        raise SystemExit("the recording could not be rewritten")
    after, took_s = os.times(), time.perf_counter() - begin_s
    busy_s = after.children_user + after.children_system
    busy_s -= before.children_user + before.children_system
    return spent_s, (took_s, busy_s), raw.stat().st_size, rewritten


def rows_in(recording):
    return sum(chunk.to_record_batch().num_rows for chunk in RrdReader(str(recording)).stream())


def opening_s(recording):
    """Return how long a viewer takes until it has drawn everything, by the clock and of processor.

    ``None`` without a driver.
    """
    try:
        with headless_viewer((1920, 1080)) as address:
            client = ViewerClient.connect(address)
            (viewer,) = psutil.Process().children()
            before, begin_s = viewer.cpu_times(), time.perf_counter()
            client.open([str(recording)])
            while client.get_state().loading or not client.get_state().recordings:
                time.sleep(0.05)
            client.set_time("session", duration=60.0, play_state="paused")
            shoot_settled(client, recording.with_suffix(".png"))
            after = viewer.cpu_times()
            busy_s = after.user + after.system - before.user - before.system
            return time.perf_counter() - begin_s, busy_s
    except CompanionError:
        return None


def both(times):
    return "{:.1f} s, {:.1f} s of processor".format(*times)


def main():
    minutes = float(sys.argv[1]) if len(sys.argv) > 1 else 60.0
    with tempfile.TemporaryDirectory() as name:
        spent_s, rewriting, raw_bytes, rewritten = record(Path(name), minutes)
        size, rows = rewritten.stat().st_size, rows_in(rewritten)
        opened = opening_s(rewritten)
    print(
        f"{minutes:g} minutes of flight, {platform.machine()}, Python {platform.python_version()}"
    )
    print()
    print("| What | Measured |")
    print("|---|---|")
    print(f"| session.rrd while flying | {raw_bytes / minutes / 1e6:.2f} MB a minute |")
    print(f"| session.rrd after the flight | {size / minutes / 1e6:.2f} MB a minute |")
    print(f"| the whole file | {size / 1e6:.1f} MB |")
    print(f"| rows | {rows / minutes / 60:.0f} a second |")
    print(f"| processor, of one core | {100 * spent_s / (60 * minutes):.1f} % |")
    print(f"| rewriting at the end | {both(rewriting)} |")
    print(f"| until the viewer has drawn it | {'-' if opened is None else both(opened)} |")


if __name__ == "__main__":
    main()
