"""A thin layer over a Rerun stream: the two timelines of a session, and columns on them."""

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt
import rerun as rr


class StreamWriter:
    """Writes to one stream on the timelines ``session`` (since the start) and ``utc``."""

    def __init__(self, stream: rr.RecordingStream, start_utc_us: int) -> None:
        self.stream = stream
        self._start_utc_ns = start_utc_us * 1000

    def static(self, path: str, *shapes: rr.AsComponents) -> None:
        """Log what does not change."""
        self.stream.log(path, *shapes, static=True)

    def at(self, time_s: float, path: str, shape: rr.AsComponents) -> None:
        """Log something that is there from ``time_s`` on."""
        since_ns = round(time_s * 1e9)
        self.stream.set_time("session", duration=np.timedelta64(since_ns, "ns"))
        self.stream.set_time("utc", timestamp=np.datetime64(self._start_utc_ns + since_ns, "ns"))
        self.stream.log(path, shape)

    def columns(self, path: str, time_s: Iterable[float], columns: rr.ComponentColumnList) -> None:
        """Send one row for each time."""
        since_ns = np.round(np.array(list(time_s), dtype=float) * 1e9).astype(np.int64)
        index = [
            rr.TimeColumn("session", duration=since_ns.astype("timedelta64[ns]")),
            rr.TimeColumn(
                "utc", timestamp=(self._start_utc_ns + since_ns).astype("datetime64[ns]")
            ),
        ]
        self.stream.send_columns(path, index, columns)

    def scalars(self, path: str, time_s: Iterable[float], values: npt.ArrayLike) -> None:
        """Send a row of values, shape ``(N,)`` or ``(N, lines)``, for each time."""
        self.columns(path, time_s, rr.Scalars.columns(scalars=np.asarray(values, dtype=float)))
