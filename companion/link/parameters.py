"""Reading the vehicle's parameters. There is no way to write one."""

from collections.abc import Iterable

from companion.link.autopilots import Autopilot
from companion.link.codec import Codec, Received


class ParameterReader:
    """Waits for the values of named parameters; all others pass by."""

    def __init__(self, codec: Codec, autopilot: Autopilot) -> None:
        self._codec = codec
        self._autopilot = autopilot
        self._names: tuple[str, ...] = ()
        self.values: dict[str, int | float] = {}
        """Of the parameters awaited, as far as they were heard."""

    @property
    def missing(self) -> list[str]:
        """Names awaited and not heard yet."""
        return [name for name in self._names if name not in self.values]

    def expect(self, names: Iterable[str]) -> None:
        """Wait for ``names`` from now on, and for nothing else."""
        self._names = tuple(names)
        self.values = {}

    def hear(self, received: Received) -> None:
        """Take in a PARAM_VALUE of the vehicle."""
        message = self._codec.decode(received)
        if message is not None and message.param_id in self._names:
            # the raw bytes: PX4 puts integers there that do not survive being a float
            raw = received.payload[:4].ljust(4, b"\0")
            self.values[message.param_id] = self._autopilot.decode_param(raw, message.param_type)
