"""The Rerun streams of a session: its file, and a live view hosted on loopback.

The live view is hosted here and viewers come to us. Dialling a viewer that is not there blocks
for seconds or for ever, and starves the file meanwhile.
"""

from collections.abc import Callable
from pathlib import Path

import rerun as rr

from companion.session.blueprint import blueprint, map_blueprint
from companion.session.folder import RECORDING
from companion.session.outputs import Sync
from companion.session.records import Event, MapRecord, Mark, Record, SessionEnd, SessionStart, Tick
from companion.session.rerun_log import SessionLog
from companion.session.scene import draw_map
from companion.session.viewer import LOOPBACK, free_port

_APPLICATION = "companion"
_FILE_PERIOD_S = 2.0  # every column costs a kilobyte, however short it is
_LIVE_PERIOD_S = 0.2
_DEFAULT_PORT = 9876  # of Rerun: `rerun --connect` needs no address
_LIVE_MEMORY = "256MiB"  # kept for viewers that come late; tens of minutes


class RerunOutput:
    """Collects records and logs them to a stream that is opened when the session starts."""

    def __init__(
        self,
        name: str,
        open_stream: Callable[[SessionStart], rr.RecordingStream],
        period_s: float,
        sync: Sync | None = None,
    ) -> None:
        """Send columns of ``period_s``; ``sync`` gets them onto the disk."""
        self.name = name
        self._open_stream = open_stream
        self._period_s = period_s
        self._sync = sync
        self._due_s = 0.0
        self._log: SessionLog | None = None
        self._ticks: list[Tick] = []
        self._events: list[Event] = []

    def write(self, record: Record) -> None:
        """Take one record; ticks and events wait for ``flush``.

        Raises:
            OSError: If the stream cannot be opened.
            RuntimeError: The same, as Rerun reports it.
        """
        if isinstance(record, SessionStart):
            self._log = SessionLog(self._open_stream(record), record)
        if self._log is None:  # before the start there is no map to draw on
            return
        match record:
            case Tick():
                self._ticks.append(record)
            case Event():
                self._events.append(record)
            case Mark():
                self._log.mark(record)
            case SessionEnd():
                self._log.end(record.summary)

    def flush(self, now_s: float) -> None:
        """Send what was collected, once in a period."""
        if now_s >= self._due_s:
            self._due_s = now_s + self._period_s
            self._send()
            if self._sync is not None and self._log is not None:
                self._sync(now_s)

    def close(self) -> None:
        """Send the rest and finish the stream."""
        self._send()
        if self._log is not None:
            self._log.close()

    def _send(self) -> None:
        if self._log is not None:
            self._log.send(self._ticks, self._events)
            self._ticks, self._events = [], []


def file_output(folder: Path, *, footer: bool) -> RerunOutput:
    """Return the output that writes ``session.rrd``.

    Args:
        folder: Of the session.
        footer: Whether the file ends with an index of itself. For that a part of every chunk is
            kept in memory until the end: some 300 MB an hour.
    """

    def open_file(start: SessionStart) -> rr.RecordingStream:
        stream = _stream(start)
        sink = rr.FileSink(folder / RECORDING, write_footer=footer)
        stream.set_sinks(sink)
        stream.send_blueprint(blueprint(start, live=False))
        return stream

    return RerunOutput(RECORDING, open_file, _FILE_PERIOD_S, Sync(folder / RECORDING))


def live_output(announce: Callable[[str], None]) -> RerunOutput:
    """Return the output that viewers attach to; ``announce`` is told its address."""

    def host(start: SessionStart) -> rr.RecordingStream:
        stream = _stream(start)
        port = free_port(_DEFAULT_PORT)
        sink = rr.GrpcServerSink(LOOPBACK, port, server_memory_limit=_LIVE_MEMORY)
        stream.set_sinks(sink)
        stream.send_blueprint(blueprint(start, live=True))
        announce(sink.uri)
        return stream

    return RerunOutput("live view", host, _LIVE_PERIOD_S)


def write_map(path: Path, city: MapRecord) -> None:
    """Write a recording that holds a map and nothing else.

    Raises:
        OSError: If the file cannot be created.
    """
    stream = rr.RecordingStream(f"{_APPLICATION}-map")
    stream.set_sinks(rr.FileSink(path))
    stream.send_blueprint(map_blueprint(city))
    draw_map(stream, city)
    stream.disconnect()


def _stream(start: SessionStart) -> rr.RecordingStream:
    stream = rr.RecordingStream(_APPLICATION, recording_id=start.session_id)
    stream.set_log_time_enabled(False)
    return stream
