"""The least that others do: a position comes in, a velocity goes out. For ``loop.py`` to compare.

``python tests/benchmarks/answers.py echo|mavutil|mavsdk PORT`` listens on UDP and answers every
LOCAL_POSITION_NED with one SET_POSITION_TARGET_LOCAL_NED, without a policy, a shield or a
recording; ``echo`` sends back the bytes themselves.
"""

import json
import socket
import sys
import time

import numpy as np
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as dialect

VELOCITY_ONLY = 0b0000_1101_1100_0111
LOCAL_NED = dialect.MAV_FRAME_LOCAL_NED


def echo(port):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as here:
        here.bind(("127.0.0.1", port))
        while True:
            data, sender = here.recvfrom(300)
            here.sendto(data, sender)


def by_mavutil(port):
    link = mavutil.mavlink_connection(f"udpin:127.0.0.1:{port}", 57600, 1, 191)
    while True:
        position = link.recv_match(type="LOCAL_POSITION_NED", blocking=True)
        link.mav.set_position_target_local_ned_send(
            position.time_boot_ms, 1, 1, LOCAL_NED, VELOCITY_ONLY, *[0.0] * 3, 1.0, *[0.0] * 7
        )


def by_mavsdk(port):
    from mavsdk import Configuration, Mavsdk
    from mavsdk.plugins.mavlink_direct import MavlinkDirect, MavlinkMessage

    mavsdk = Mavsdk(Configuration.create_manual(1, 191, True))
    mavsdk.add_any_connection(f"udpin://127.0.0.1:{port}")
    vehicle = mavsdk.first_autopilot(30.0)
    direct = MavlinkDirect(vehicle)
    names = ("x", "y", "z", "vx", "vy", "vz", "afx", "afy", "afz", "yaw", "yaw_rate")
    fields = dict.fromkeys(names, 0.0) | {
        "target_system": 1,
        "target_component": 1,
        "coordinate_frame": LOCAL_NED,
        "type_mask": VELOCITY_ONLY,
        "vx": 1.0,
    }

    def answer(position, _):
        boot_ms = json.loads(position.fields_json)["time_boot_ms"]
        direct.send_message(
            MavlinkMessage(
                message_name="SET_POSITION_TARGET_LOCAL_NED",
                system_id=1,
                component_id=191,
                target_system_id=1,
                target_component_id=1,
                fields_json=json.dumps(fields | {"time_boot_ms": boot_ms}),
            )
        )

    direct.subscribe_message("LOCAL_POSITION_NED", answer)
    while True:
        time.sleep(1.0)


def round_trips_ms(port, seconds, rate_hz):
    """Play a vehicle to whoever listens on ``port``; return how long each answer took."""
    vehicle = dialect.MAVLink(None, 1, 1)
    heartbeat = dialect.MAVLink_heartbeat_message(2, 12, 81, 0, 3, 3)
    trips, buffer = [], dialect.MAVLink(None)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as here:
        here.settimeout(0.2)
        start, ticks, heartbeat_due_s = time.monotonic(), 0, 0.0
        while len(trips) < seconds * rate_hz and time.monotonic() < start + seconds + 15.0:
            time.sleep(max(0.0, start + ticks / rate_hz - time.monotonic()))
            if time.monotonic() >= heartbeat_due_s:
                here.sendto(heartbeat.pack(vehicle), ("127.0.0.1", port))
                heartbeat_due_s = time.monotonic() + 1.0
            position = dialect.MAVLink_local_position_ned_message(ticks, *[0.0] * 6)
            ticks += 1
            sent = time.perf_counter()
            try:
                here.sendto(position.pack(vehicle), ("127.0.0.1", port))
                while True:
                    names = [m.get_type() for m in buffer.parse_buffer(here.recv(300)) or []]
                    # An echo sends the heartbeat back, too.
                    if {"LOCAL_POSITION_NED", "SET_POSITION_TARGET_LOCAL_NED"} & set(names):
                        break
            except OSError:  # nobody there yet
                start = time.monotonic() - ticks / rate_hz
                continue
            trips.append(1e3 * (time.perf_counter() - sent))
    return np.percentile(trips, [50, 99])


if __name__ == "__main__":
    answer_by = {"echo": echo, "mavutil": by_mavutil, "mavsdk": by_mavsdk}[sys.argv[1]]
    answer_by(int(sys.argv[2]))
