"""Faults on a schedule: ``t=12,kind=gps_glitch,size=15,for=5``.

A fault begins ``t`` seconds after the event named by ``from`` (``start``, ``arm`` or
``offboard``: setpoints fly the vehicle; the first of each) and, where it can be undone, ends
``for`` seconds later.
"""

import heapq
import math
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from sim.mock.fault_kinds import KINDS, Act
from sim.mock.personality import Personality
from sim.mock.px4.personality import PX4
from sim.mock.specs import Spec

if TYPE_CHECKING:
    from sim.mock.vehicle import MockVehicle

EVENTS = dict.fromkeys(("start", "arm", "offboard"))
COMMON_KEYS = ("t", "from", "kind", "for")


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault of a schedule."""

    text: str
    act: Act
    event: str
    delay_s: float
    duration_s: float


def parse_fault(
    text: str, *, links: int, targets: Collection[int], personality: Personality = PX4
) -> Fault:
    """Read ``t=SECONDS,kind=KIND,...``; every value is checked before anything flies.

    Args:
        text: The specification.
        links: How many links there are.
        targets: System ids of the targets there are.
        personality: The autopilot that it befalls.

    Raises:
        UsageError: If the kind or a key is unknown, or a value makes no sense.
    """
    spec = Spec("--fault", text)
    name = spec.choice("kind", KINDS)
    kind = KINDS[name]
    spec.check_keys(dict.fromkeys((*COMMON_KEYS, *kind.keys)))
    if name in personality.silent_faults:
        raise spec.error(f"{name} cannot befall {personality.name}")
    if "mode" in kind.keys:
        spec.choice("mode", personality.kind.modes, personality.kind.hold_mode)
    if "link" in kind.keys and spec.number("link", 1.0, low=1.0) > links:
        raise spec.error(f"there are only {links} links")
    if "sysid" in kind.keys:
        default = next(iter(targets), 0)
        if int(spec.number("sysid", default)) not in targets:
            raise spec.error("there is no such --target")
    return Fault(
        text=text,
        act=kind.plan(spec),
        event=spec.choice("from", EVENTS, "start"),
        delay_s=spec.number("t", 0.0, low=0.0),
        duration_s=spec.number("for", math.inf, low=0.0),
    )


@dataclass(slots=True)
class Schedule:
    """The faults still to come, and the ends of those that last."""

    faults: list[Fault]
    _due: list[tuple[float, int, Callable[["MockVehicle"], None]]] = field(default_factory=list)
    _seen: set[str] = field(default_factory=set)
    _count: int = 0

    def tick(self, now_s: float, vehicle: "MockVehicle") -> None:
        """Begin and end what is due at ``now_s``."""
        if not self.faults:
            return
        happening = {
            "start": True,
            "arm": vehicle.autopilot.armed,
            "offboard": vehicle.autopilot.steered,
        }
        for fault in self.faults:
            if happening[fault.event] and fault.event not in self._seen:
                self._add(now_s + fault.delay_s, self._begin(fault))
        self._seen |= {event for event, now in happening.items() if now}
        while self._due and self._due[0][0] <= now_s + 1e-9:
            heapq.heappop(self._due)[2](vehicle)

    def _add(self, time_s: float, action: Callable[["MockVehicle"], None]) -> None:
        self._count += 1
        heapq.heappush(self._due, (time_s, self._count, action))

    def _begin(self, fault: Fault) -> Callable[["MockVehicle"], None]:
        def begin(vehicle: "MockVehicle") -> None:
            vehicle.log(f"fault {fault.text}")
            undo = fault.act(vehicle)
            if undo is None or not math.isfinite(fault.duration_s):
                return

            def end(vehicle: "MockVehicle") -> None:
                undo()
                vehicle.log(f"fault {fault.text} ends")

            self._add(vehicle.time_s + fault.duration_s, end)

        return begin
