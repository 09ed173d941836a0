"""How often messages really come, and which must be asked for."""

from collections.abc import Iterator, Mapping

from pymavlink.dialects.v20 import ardupilotmega as dialect

_WINDOW_S = 2.0
_ASK_AGAIN_S = 5.0
_TOO_SLOW = 0.7
"""Share of the wanted rate below which it is asked for; PX4 gives 9.8 of 10."""


class RateMeter:
    """Counts one sender's messages in windows of two seconds."""

    def __init__(self, now_s: float) -> None:
        self._window_start_s = now_s
        self._counts: dict[int, int] = {}
        self._rates_hz: dict[int, float] = {}
        self._asked_s: dict[int, float] = {}

    def count(self, message_id: int) -> None:
        """Record one message."""
        self._counts[message_id] = self._counts.get(message_id, 0) + 1

    def turn(self, now_s: float) -> bool:
        """Close the window if it is full; return whether it was."""
        elapsed_s = now_s - self._window_start_s
        if elapsed_s < _WINDOW_S:
            return False
        self._rates_hz = {key: count / elapsed_s for key, count in self._counts.items()}
        self._counts = {}
        self._window_start_s = now_s
        return True

    def too_slow(self, wanted_hz: Mapping[int, float], now_s: float) -> Iterator[tuple[int, float]]:
        """Return the messages to ask for now, with their rate; each at most every 5 s.

        The measured rate decides, not an acknowledgement: others on the link change rates too.
        """
        for message_id, rate_hz in wanted_hz.items():
            asked_s = self._asked_s.get(message_id)
            if self._rates_hz.get(message_id, 0.0) >= _TOO_SLOW * rate_hz:
                continue
            if asked_s is None or now_s - asked_s >= _ASK_AGAIN_S:
                self._asked_s[message_id] = now_s
                yield message_id, rate_hz

    def forget_asking(self) -> None:
        """Ask anew: the autopilot has rebooted and knows nothing of it."""
        self._asked_s = {}

    def rates_hz(self) -> dict[str, float]:
        """Return the rates of the last full window by message name."""
        return {_name(key): rate_hz for key, rate_hz in self._rates_hz.items()}


def _name(message_id: int) -> str:
    known = dialect.mavlink_map.get(message_id)
    return str(known.msgname) if known else f"UNKNOWN_{message_id}"
