"""What nobody should send, and how the PX4 personality takes it."""

import math

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim.mock.bench import Bench


def booted(**options):
    bench = Bench(**options)
    bench.run(2.0)
    return bench


def random_message(rng, number):
    """Any message the dialect knows, with random bytes for fields, packed as a real one."""
    message_class = mavlink.mavlink_map[number]
    size = message_class.unpacker.size
    payload = bytearray(rng.integers(0, 256, size, dtype="uint8").tobytes())
    names = message_class.ordered_fieldnames
    offsets = dict(zip(names, offsets_of(message_class), strict=True))
    for name in ("target_system", "target_component", "target"):
        if name in offsets:
            payload[offsets[name]] = 1
    codec = mavlink.MAVLink(None, srcSystem=1, srcComponent=191)
    message = mavlink.MAVLink_message(number, message_class.msgname)
    return message._pack(codec, message_class.crc_extra, bytes(payload))


def offsets_of(message_class):
    offset, sizes = 0, {"c": 1, "b": 1, "B": 1, "h": 2, "H": 2, "i": 4, "I": 4, "f": 4, "q": 8}
    codes = bytes(message_class.native_format).decode().lstrip("<")
    for code, count in zip(codes, message_class.array_lengths, strict=True):
        yield offset
        offset += sizes.get(code, 8) * max(1, count)


# -- texts and routing ---------------------------------------------------------------------


def test_garbage_and_split_packets_do_not_disturb():
    bench = booted()
    codec = mavlink.MAVLink(None, srcSystem=1, srcComponent=191)
    packet = mavlink.MAVLink_command_long_message(1, 1, 512, 0, 148.0, *(0.0,) * 6).pack(codec)
    bench.vehicle.receive(0, b"\x00\xfe\xfd garbage \xfd\x03")
    for byte in packet:
        bench.vehicle.receive(0, bytes([byte]))
    for _ in range(10):  # a false start swallows bytes until its length is filled
        bench.vehicle.receive(0, packet)
    bench.run(0.1)
    assert bench.all("AUTOPILOT_VERSION")


# -- robustness ----------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_no_message_whatever_it_holds_stops_the_vehicle(seed):
    rng = np.random.default_rng(seed)
    bench = Bench(ground_links=(False, True), seed=seed)
    bench.run(2.0)
    bench.command(400, 1.0)
    bench.command(22, 0, 0, 0, math.nan, math.nan, math.nan, 500.0)
    numbers = [number for number in mavlink.mavlink_map if number not in (38, 39)]
    handled = [75, 76, 84, 86, 11, 69, 23, 20, 21, 43, 110, 111, 4]
    for _ in range(1500):
        number = int(rng.choice(handled if rng.random() < 0.7 else numbers))
        bench.vehicle.receive(int(rng.integers(2)), random_message(rng, number))
        bench.run(0.01)
    bench.run(2.0)
    assert math.isfinite(bench.last("LOCAL_POSITION_NED", link=0).x)


@pytest.mark.parametrize("number", [511, 512, 176, 400, 22, 192])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 3e38, -1.0])
def test_commands_with_silly_values_get_an_answer(number, value):
    bench = booted()
    assert bench.command(number, *(value,) * 7) in range(5)
    bench.run(1.0)
