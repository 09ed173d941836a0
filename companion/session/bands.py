"""The bands under the scene: in which state everything was, from when to when."""

from collections.abc import Callable, Sequence

import rerun as rr

from companion.session.colors import band_color
from companion.session.records import Tick
from companion.session.writer import StreamWriter

BANDS: dict[str, Callable[[Tick], str]] = {
    "state/companion": lambda tick: tick.supervisor,
    "state/flight_mode": lambda tick: tick.mode,
    "state/motors": lambda tick: "armed" if tick.armed else "disarmed",
    "state/shield": lambda tick: tick.shield_reason or ("clear" if tick.action else ""),
    "state/target": lambda tick: tick.target_tier,
}
_UNKNOWN = "-"


class StateBand:
    """Logs one state when it changes, and the colour of a word when it is first seen."""

    def __init__(self, writer: StreamWriter, path: str) -> None:
        self._writer = writer
        self._path = path
        self._now: str | None = None
        self._seen: list[str] = []

    def send(self, states: Sequence[tuple[float, str]]) -> None:
        """Send what changes in ``states``, the state at each time."""
        changes: list[tuple[float, str]] = []
        for time_s, word in states:
            if word != self._now:
                self._now = word
                changes.append((time_s, word))
        if not changes:
            return
        self._style([word for _, word in changes])
        columns = rr.StateChange.columns(state=[word for _, word in changes])
        self._writer.columns(self._path, [time_s for time_s, _ in changes], columns)

    def _style(self, words: Sequence[str]) -> None:
        seen = self._seen
        new = [word for word in dict.fromkeys(words) if word not in seen]
        if new:
            seen += new
            colors = [band_color(word, index) for index, word in enumerate(seen)]
            self._writer.static(
                self._path, rr.StateConfiguration(values=seen, labels=seen, colors=colors)
            )


class Bands:
    """Logs the states of a session of ours."""

    def __init__(self, writer: StreamWriter) -> None:
        self._bands = [(StateBand(writer, path), word_of) for path, word_of in BANDS.items()]

    def send(self, ticks: Sequence[Tick]) -> None:
        """Send the changes of one batch."""
        for band, word_of in self._bands:
            band.send([(tick.time_s, word_of(tick) or _UNKNOWN) for tick in ticks])
