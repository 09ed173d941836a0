"""What happened in a flight, line by line and band by band, as the parts of the review tell it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

from companion.review.log_file import Frame
from companion.session.records import Event
from companion.vehicle import Severity

Bands = dict[str, list[tuple[float, str]]]
"""By name: the state that begins at each time."""


class Message(NamedTuple):
    """One decoded message."""

    time_s: float
    system_id: int
    component_id: int
    fields: Any
    """pymavlink's message object."""


class Part(Protocol):
    """One part of the review: takes the messages it wants, tells the story what they mean."""

    @property
    def handlers(self) -> Mapping[int, Callable[[Message], None]]:
        """What to call with a message, by its id."""
        ...

    def finish(self, end_s: float) -> None:
        """Tell what can only be told at the end."""
        ...


@dataclass
class Story:
    """The events and states of a flight, and what the parts need to know of each other."""

    vehicle: int = 0
    """System id."""
    component: int = 1
    """Of the autopilot."""
    events: list[Event] = field(default_factory=list)
    bands: Bands = field(default_factory=dict)
    facts: list[tuple[str, str]] = field(default_factory=list)
    """Name and value, for the table."""
    who: Callable[[int, int], str] = "{}/{}".format
    """Names a sender for people."""
    armed: bool = False
    in_air: bool = False
    external: bool = False
    """Whether setpoints fly the vehicle: OFFBOARD or GUIDED."""
    failsafe_s: float | None = None
    """When the autopilot last spoke of a failsafe."""
    handed_over_s: float | None = None
    """When somebody last asked the vehicle out of the mode that setpoints fly."""
    landed_s: float | None = None
    """When the vehicle last touched the ground."""
    stream_began_s: float | None = None
    """When setpoints began to flow, or flowed again after a gap."""
    setpoint_s: float | None = None
    """When the last setpoint was sent."""

    def is_autopilot(self, sender: Message | Frame) -> bool:
        """Return whether it is the autopilot itself that speaks."""
        return (sender.system_id, sender.component_id) == (self.vehicle, self.component)

    def tell(self, time_s: float, text: str, severity: Severity = Severity.INFO) -> None:
        """Add a line of our own."""
        self.events.append(Event(time_s, severity, "review", text))

    def warn(self, time_s: float, text: str) -> None:
        """Add a line of our own that nobody should miss."""
        self.tell(time_s, text, Severity.WARNING)

    def last_warning(self, since_s: float) -> str:
        """Return the newest warning of our own that is no older than ``since_s``, empty if none."""
        lately = [
            event
            for event in self.events
            if event.severity is Severity.WARNING
            and event.source == "review"
            and event.time_s >= since_s
        ]
        return lately[-1].text if lately else ""

    def band(self, name: str, time_s: float, word: str) -> bool:
        """Set a state; return whether that is a change."""
        changes = self.bands.setdefault(name, [])
        if changes and changes[-1][1] == word:
            return False
        changes.append((time_s, word))
        return True

    def now(self, name: str) -> str:
        """Return a state as it stands, empty before it was known."""
        changes = self.bands.get(name)
        return changes[-1][1] if changes else ""
