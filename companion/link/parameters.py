"""Reading the vehicle's parameters. There is no way to write one."""

from companion.link.autopilots import Autopilot
from companion.link.codec import Codec, Received


class ParameterReader:
    """Waits for the value of one parameter at a time; all others pass by."""

    def __init__(self, codec: Codec, autopilot: Autopilot) -> None:
        self._codec = codec
        self._autopilot = autopilot
        self._name = ""
        self.value: int | float | None = None
        """Of the parameter awaited, once it was heard."""

    def expect(self, name: str) -> None:
        """Wait for ``name`` from now on."""
        self._name = name
        self.value = None

    def hear(self, received: Received) -> None:
        """Take in a PARAM_VALUE of the vehicle."""
        message = self._codec.decode(received)
        if message is not None and message.param_id == self._name:
            # the raw bytes: PX4 puts integers there that do not survive being a float
            raw = received.payload[:4].ljust(4, b"\0")
            self.value = self._autopilot.decode_param(raw, message.param_type)
