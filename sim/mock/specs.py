"""Specifications of the form ``key=value,key=value``, as ``--target`` and ``--fault`` take them."""

import math
from collections.abc import Mapping

from companion.errors import UsageError


class Spec:
    """A parsed specification whose every key must be asked for.

    Args:
        option: The option it came from, for messages.
        text: ``key=value,...``.

    Raises:
        UsageError: If it is not of that form.
    """

    def __init__(self, option: str, text: str) -> None:
        self._where = f"{option} {text}"
        self._values: dict[str, str] = {}
        for part in text.split(","):
            key, equals, value = part.partition("=")
            if not equals or not key or not value or key in self._values:
                raise UsageError(f"{self._where}: expected key=value,key=value,...")
            self._values[key] = value

    def error(self, message: str) -> UsageError:
        """Return an error about this specification."""
        return UsageError(f"{self._where}: {message}")

    def check_keys(self, allowed: Mapping[str, object]) -> None:
        """Refuse keys that mean nothing here.

        Raises:
            UsageError: Naming the key and those that exist.
        """
        for key in self._values:
            if key not in allowed:
                raise self.error(f"unknown key {key}; there are: {', '.join(allowed)}")

    def choice(self, key: str, allowed: Mapping[str, object], default: str | None = None) -> str:
        """Return one of a few words."""
        value = self._values.get(key, default)
        if value is None or value not in allowed:
            raise self.error(f"{key} must be one of {', '.join(allowed)}")
        return value

    def word(self, key: str) -> str | None:
        """Return any word, ``None`` where it is not given."""
        return self._values.get(key)

    def number(
        self, key: str, default: float, *, low: float = -math.inf, high: float = math.inf
    ) -> float:
        """Return a finite number from ``low`` to ``high``; the default may be infinite."""
        if key not in self._values:
            return default
        try:
            value = float(self._values[key])
        except ValueError:
            value = math.nan
        if not (math.isfinite(value) and low <= value <= high):
            bounds = f" of at least {low:g}" if math.isfinite(low) else ""
            bounds += f" and at most {high:g}" if math.isfinite(high) else ""
            raise self.error(f"{key} must be a number{bounds}, got {self._values[key]}")
        return value

    def point(self, key: str) -> tuple[float, float, float] | None:
        """Return a point written ``E:N:U``, ``None`` where it is not given."""
        if key not in self._values:
            return None
        try:
            east, north, up = (float(part) for part in self._values[key].split(":"))
        except ValueError:
            raise self.error(f"{key} must be E:N:U in metres, got {self._values[key]}") from None
        if not all(map(math.isfinite, (east, north, up))):
            raise self.error(f"{key} must be finite")
        return east, north, up
