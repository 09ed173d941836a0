"""An impartial judge of the flight: contacts, clearance, speed, and what was asked for when."""

import math
from dataclasses import dataclass, field
from typing import Any

from sim.mock.autopilot import Autopilot, FlightMode
from sim.mock.dynamics import Vector
from sim.mock.placement import Place

PERIOD_S = 0.05


@dataclass(frozen=True, slots=True)
class Contact:
    """The beginning of a contact with an obstacle."""

    time_s: float
    position_enu_m: tuple[float, float, float]
    speed_mps: float


@dataclass(slots=True)
class Referee:
    """Watches one vehicle in one place."""

    place: Place
    contacts: list[Contact] = field(default_factory=list)
    min_clearance_m: float = math.inf
    distance_flown_m: float = 0.0
    max_speed_mps: float = 0.0
    left_map: bool = False
    timeline: list[tuple[float, str]] = field(default_factory=list)
    """Changes of mode and arming, as (time, words)."""
    setpoints_by_sender: dict[str, int] = field(default_factory=dict)
    setpoints_after_mode_shown: int = 0
    """Setpoints sent although a HEARTBEAT had said that OFFBOARD (GUIDED) is over: a good
    companion has none of them but for the one that was under way."""
    _last_m: Vector | None = None
    _state: tuple[FlightMode, bool, str | None] | None = None
    _touching: bool = False
    _offboard_flown: bool = False

    def note(self, time_s: float, words: str) -> None:
        """Add to the timeline, if it says something new."""
        if not self.timeline or self.timeline[-1][1] != words:
            self.timeline.append((round(time_s, 3), words))

    def count_setpoint(self, sender: str, mode: FlightMode, shown_mode: FlightMode | None) -> None:
        """Count one setpoint message.

        Args:
            sender: ``system/component``.
            mode: The mode the vehicle is in.
            shown_mode: The mode in the newest HEARTBEAT on the sender's link.
        """
        self.setpoints_by_sender[sender] = self.setpoints_by_sender.get(sender, 0) + 1
        if self._offboard_flown and mode is shown_mode and not mode.is_external:
            self.setpoints_after_mode_shown += 1

    def observe(self, time_s: float, autopilot: Autopilot) -> Contact | None:
        """Look at the vehicle; called every ``PERIOD_S``.

        Returns:
            The contact that began since the last look, if any.
        """
        self._note_state(time_s, autopilot)
        self._offboard_flown |= autopilot.armed and autopilot.mode.is_external
        here_m = autopilot.body.position_m
        last_m = here_m if self._last_m is None else self._last_m
        self._last_m = here_m
        if autopilot.landed:
            return None
        speed_mps = math.hypot(*autopilot.body.velocity_mps)
        self.distance_flown_m += math.dist(here_m, last_m)
        self.max_speed_mps = max(self.max_speed_mps, speed_mps)
        map_ = self.place.map
        if map_ is None:
            return None
        here, last = self.place.to_map(here_m), self.place.to_map(last_m)
        self.left_map |= not bool(map_.contains(here))
        clearance_m = float(map_.obstacles.signed_distance_m(here))
        self.min_clearance_m = min(self.min_clearance_m, clearance_m)
        # A thin corner may lie between two looks: the way counts, not only its ends.
        touching = clearance_m <= 0.0 or float(map_.obstacles.crash_depth_m(last, here)) > 0.0
        begins, self._touching = touching and not self._touching, touching
        if not begins:
            return None
        east, north, up = (round(float(value), 3) for value in here)
        contact = Contact(round(time_s, 3), (east, north, up), round(speed_mps, 3))
        self.contacts.append(contact)
        return contact

    def _note_state(self, time_s: float, autopilot: Autopilot) -> None:
        state = autopilot.mode, autopilot.armed, autopilot.failsafe_words
        if state == self._state:
            return
        self._state = state
        armed = "armed" if autopilot.armed else "disarmed"
        cause = f" (failsafe: {state[2]})" if state[2] else ""
        self.note(time_s, f"{autopilot.mode.name} {armed}{cause}")

    def report(self, time_s: float, autopilot: Autopilot) -> dict[str, Any]:
        """Return the verdict as plain data for JSON."""
        clearance = self.min_clearance_m
        return {
            "duration_s": round(time_s, 3),
            "map": None if self.place.map is None else self.place.map.name,
            "contacts": [
                {"time_s": c.time_s, "position_enu_m": c.position_enu_m, "speed_mps": c.speed_mps}
                for c in self.contacts
            ],
            "min_clearance_m": round(clearance, 3) if math.isfinite(clearance) else None,
            "left_map": self.left_map,
            "distance_flown_m": round(self.distance_flown_m, 3),
            "max_speed_mps": round(self.max_speed_mps, 3),
            "setpoints_received": autopilot.setpoints_received,
            "setpoints_outside_offboard": autopilot.setpoints_outside_offboard,
            "setpoints_refused": autopilot.setpoints_refused,
            "setpoints_after_mode_shown": self.setpoints_after_mode_shown,
            "setpoints_by_sender": self.setpoints_by_sender,
            "timeline": self.timeline,
        }
