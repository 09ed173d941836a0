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


class Bands:
    """Logs a state when it changes, and its colour when it is first seen."""

    def __init__(self, writer: StreamWriter) -> None:
        self._writer = writer
        self._now: dict[str, str] = {}
        self._seen: dict[str, list[str]] = {path: [] for path in BANDS}

    def send(self, ticks: Sequence[Tick]) -> None:
        """Send the changes of one batch."""
        for path, word_of in BANDS.items():
            changes: list[tuple[float, str]] = []
            for tick in ticks:
                word = word_of(tick) or _UNKNOWN
                if word != self._now.get(path):
                    self._now[path] = word
                    changes.append((tick.time_s, word))
            if changes:
                words = [word for _, word in changes]
                self._style(path, words)
                times_s = [time_s for time_s, _ in changes]
                self._writer.columns(path, times_s, rr.StateChange.columns(state=words))

    def _style(self, path: str, words: Sequence[str]) -> None:
        seen = self._seen[path]
        new = [word for word in dict.fromkeys(words) if word not in seen]
        if new:
            seen += new
            colors = [band_color(word, index) for index, word in enumerate(seen)]
            self._writer.static(
                path, rr.StateConfiguration(values=seen, labels=seen, colors=colors)
            )
