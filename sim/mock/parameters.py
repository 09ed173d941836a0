"""A table of named parameters, as an autopilot keeps it."""

from abc import ABC, abstractmethod
from collections.abc import Mapping

NO_INDEX = 65535


class Parameters(ABC):
    """Named values, each of one type for ever; how they travel is the autopilot's own."""

    def __init__(self, defaults: Mapping[str, int | float]) -> None:
        self._values: dict[str, int | float] = dict(sorted(defaults.items()))
        self._names = list(self._values)

    def __len__(self) -> int:
        return len(self._names)

    def number(self, name: str) -> float:
        """Return a value as a number for the autopilot's own use."""
        return self._values[name]

    def override(self, name: str, value: float) -> None:
        """Set a value from our own side, keeping its type.

        Raises:
            KeyError: If there is no such parameter.
        """
        self._values[name] = int(value) if isinstance(self._values[name], int) else float(value)

    def name_at(self, index: int) -> str | None:
        """Return the name at ``index``, ``None`` outside the table."""
        return self._names[index] if 0 <= index < len(self._names) else None

    def index_of(self, name: str) -> int:
        """Return the index of a parameter that exists."""
        return self._names.index(name)

    @abstractmethod
    def index_when_named(self, name: str) -> int:
        """Return PARAM_VALUE.param_index in the answer to a request by name."""

    @abstractmethod
    def wire_type(self, name: str) -> int | None:
        """Return MAV_PARAM_TYPE, ``None`` for a parameter that does not exist."""

    @abstractmethod
    def wire_bytes(self, name: str) -> bytes:
        """Return the four bytes of PARAM_VALUE.param_value."""

    @abstractmethod
    def store(self, name: str, wire_type: int, raw: bytes) -> bool:
        """Take the four bytes of PARAM_SET.param_value.

        Returns:
            Whether PARAM_VALUE answers.
        """
