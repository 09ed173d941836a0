"""The mock's own way from fields to bytes: it must say what pymavlink says."""

import inspect
import math
import random

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim.mock.packet import Packer, layout, message_id, message_name, sender_of

KINDS = sorted(mavlink.mavlink_map.values(), key=lambda kind: int(kind.id))
RANGES = {
    "char": (32, 126),
    **{f"int{bits}_t": (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) for bits in (8, 16, 32, 64)},
    **{f"uint{bits}_t": (0, 2**bits - 1) for bits in (8, 16, 32, 64)},
}


def some_fields(kind, rng):
    """Return valid values for all fields of a message, in the order of its constructor."""
    sizes = dict(zip(kind.ordered_fieldnames, kind.array_lengths, strict=True))

    def one(field_type):
        if field_type in ("float", "double"):
            return rng.choice([0.0, -1.5, math.nan, math.inf, rng.uniform(-1e6, 1e6)])
        return rng.choice([0, *RANGES[field_type], rng.randint(*RANGES[field_type])])

    fields = []
    for name, field_type in zip(kind.fieldnames, kind.fieldtypes, strict=True):
        if field_type == "char" and sizes[name]:
            fields.append(b"x" * rng.randint(0, sizes[name]))
        elif sizes[name]:
            fields.append(tuple(one(field_type) for _ in range(sizes[name])))
        else:
            fields.append(b"y" if field_type == "char" else one(field_type))
    return fields


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.msgname)
def test_every_message_has_the_bytes_of_pymavlink(kind):
    rng = random.Random(kind.id)
    packer, codec = Packer(7, 9), mavlink.MAVLink(None, 7, 9)
    parameters = list(inspect.signature(kind).parameters.values())
    needed = [p for p in parameters if p.default is inspect.Parameter.empty]
    for _ in range(3):
        fields = some_fields(kind, rng)
        for given in (fields, fields[: len(needed)]):  # what is left out has its default
            packet = packer.pack(layout(kind)(*given))
            assert packet == kind(*given).pack(codec)
            assert (message_id(packet), message_name(packet)) == (kind.id, kind.msgname)
            assert sender_of(packet) == (7, 9)
            codec.seq = (codec.seq + 1) % 256


def test_drafts_and_messages_share_one_count():
    packer = Packer(1, 1)
    ping = mavlink.MAVLink_ping_message
    packets = [packer.pack(kind(1, 2, 3, 4)) for kind in (ping, layout(ping)) * 200]
    assert [packet[4] for packet in packets] == [number % 256 for number in range(400)]
