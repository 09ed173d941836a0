"""Messages by number, with how to build them."""

from collections.abc import Callable, Mapping
from typing import Any

Builder = Callable[[Any], Any]
"""Takes an autopilot, returns a message, or ``None`` while there is nothing to say."""
Builders = Mapping[int, Builder]
