"""Messages as packets: what a vehicle sends hundreds of times a second has to be cheap."""

import inspect
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache, cached_property
from operator import itemgetter
from typing import Any

from fastcrc.crc16 import mcrf4xx
from pymavlink.dialects.v20 import ardupilotmega as mavlink

MAVLINK2 = 0xFD
_CRC_START = 0xFFFF


def message_id(packet: bytes) -> int:
    """Return the message id of one complete MAVLink packet."""
    return int.from_bytes(packet[7:10], "little") if packet[0] == MAVLINK2 else packet[5]


def message_name(packet: bytes) -> str:
    """Return the name of the message in a packet, ``UNKNOWN`` where pymavlink has none."""
    known = mavlink.mavlink_map.get(message_id(packet))
    return "UNKNOWN" if known is None else str(known.msgname)


def sender_of(packet: bytes) -> tuple[int, int]:
    """Return the system and component id of one complete MAVLink packet."""
    first = 5 if packet[0] == MAVLINK2 else 3
    return packet[first], packet[first + 1]


@dataclass(frozen=True)
class Definition:
    """What a packet needs to know of the definition of its message."""

    message_id: int
    crc_extra: int
    """What the definition adds to the checksum."""

    @cached_property
    def number(self) -> bytes:
        """The message id as it stands in a packet."""
        return self.message_id.to_bytes(3, "little")

    @cached_property
    def seed(self) -> bytes:
        """The end of what the checksum is of."""
        return bytes((self.crc_extra,))


Draft = tuple[Definition, bytes]
"""A message and its fields in wire order; zeros at the end are cut off when it is sent."""


@cache
def layout(kind: Any) -> Callable[..., Draft]:
    """Return a quick stand-in for a class of pymavlink, from how its fields lie on the wire.

    Called with the arguments of that class it gives a draft that becomes the same packet, several
    times as fast. Arrays are tuples.

    Args:
        kind: The class, for example ``MAVLink_attitude_message``.
    """
    definition, pack = Definition(kind.id, kind.crc_extra), kind.unpacker.pack
    order = [kind.fieldnames.index(name) for name in kind.ordered_fieldnames]
    in_wire_order: Any = itemgetter(*order) if len(order) > 1 else tuple
    parameters = inspect.signature(kind).parameters.values()
    defaults = tuple(parameter.default for parameter in parameters)
    has_arrays = any(kind.array_lengths)

    def plain(*fields: Any) -> Draft:
        return definition, pack(*fields)

    def sorted_and_flat(*fields: Any) -> Draft:
        values = in_wire_order(fields + defaults[len(fields) :])
        return definition, pack(*(_flat(values) if has_arrays else values))

    is_plain = (
        order == sorted(order) and not has_arrays and inspect.Parameter.empty in defaults[-1:]
    )
    return plain if is_plain else sorted_and_flat


def _flat(values: Iterable[Any]) -> list[Any]:
    flat: list[Any] = []
    for value in values:
        if type(value) is tuple:
            flat += value
        else:
            flat.append(value)
    return flat


class Packer:
    """Puts the messages of one sender into unsigned MAVLink 2 packets, and counts them.

    Args:
        system_id: The sender's system.
        component_id: Its component.
    """

    def __init__(self, system_id: int, component_id: int) -> None:
        self._codec: Any = mavlink.MAVLink(None, system_id, component_id)
        self._sender = bytes((system_id, component_id))
        self._sequence = 0

    def pack(self, message: Any) -> bytes:
        """Return the packet of a message of pymavlink, or of a ``Draft``."""
        sequence = self._sequence
        self._sequence = (sequence + 1) & 0xFF
        if type(message) is not tuple:
            self._codec.seq = sequence
            return bytes(message.pack(self._codec))
        definition, fields = message
        payload = fields.rstrip(b"\0") or b"\0"
        head = b"%c\0\0%c" % (len(payload), sequence)
        body: bytes = head + self._sender + definition.number + payload
        checksum = mcrf4xx(body + definition.seed, _CRC_START)
        return b"\xfd" + body + checksum.to_bytes(2, "little")


def crc_extra_of(message: Any) -> int:
    """Return what the definition of a message, or of a ``Draft``, adds to the checksum."""
    crc_extra: int = (message[0] if type(message) is tuple else message).crc_extra
    return crc_extra
