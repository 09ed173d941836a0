"""The only place that reads a clock."""

import time
from datetime import UTC, datetime


def now_s() -> float:
    """Return the monotonic time in seconds; only differences mean anything."""
    return time.monotonic()  # noqa: TID251


def utc_now() -> datetime:
    """Return the wall-clock time, for file names and log stamps, never for ages."""
    return datetime.now(UTC)


def sleep_s(duration_s: float) -> None:
    """Block for ``duration_s``; for processes that have nothing to wait on."""
    time.sleep(max(0.0, duration_s))  # noqa: TID251
