"""What a personality is: an autopilot with its links, its place and its manners."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any

from companion.world.frames import GeoPoint
from sim.mock.autopilot import Autopilot, PowerUp
from sim.mock.channel import Channel, Port
from sim.mock.dynamics import Response
from sim.mock.geodesy import Projection
from sim.mock.incoming import Handler


@dataclass(frozen=True, slots=True)
class Personality:
    """One kind of autopilot."""

    name: str
    """The word for it on the command line."""
    kind: type[Autopilot]
    build: Callable[[PowerUp], Autopilot]
    """Switches one on."""
    open_channel: Callable[[Port], Channel]
    """Opens a link."""
    rates_of: Callable[[bool], str]
    """What a link sends unasked, in words; told whether it has ground-station rates."""
    handlers: Mapping[str, Handler]
    """What it does with messages, by their names."""
    is_for_us: Callable[[Any, int, Collection[tuple[int, int]]], bool]
    """Whether a message is for the autopilot with this system id, given who was heard on other
    links."""
    projection: Callable[[GeoPoint], Projection]
    home: GeoPoint
    """Where its simulator boots."""
    response: Response
    """How its simulator answers velocity demands."""
    unsigned_allowed: Collection[int] = ()
    """Messages that it takes without a signature, where there is a key."""
    trusts_usb: bool = False
    """Whether it takes all packets without a signature on its USB port."""
    silent_faults: Collection[str] = ()
    """Kinds of faults that cannot befall it."""
