"""Join STATUSTEXT chunks; cut long texts into chunks."""

from collections.abc import Iterator
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

_CHUNK_BYTES = 50
_PATIENCE_S = 1.0
"""A text whose next chunk does not come within this is shown as far as it came."""


class TextAssembler:
    """Joins the chunks of one sender's texts; a text is whole when a chunk is not full."""

    def __init__(self) -> None:
        self._id = 0
        self._text = ""
        self._severity = 0
        self._next_chunk = 0
        self._since_s = 0.0

    def add(self, message: Any, now_s: float) -> list[tuple[int, str]]:
        """Take in one STATUSTEXT; return what became whole as ``(MAV_SEVERITY, text)``."""
        if message.id == 0:
            return [(message.severity, _clean(message.text))]
        whole: list[tuple[int, str]] = []
        if message.id != self._id or message.chunk_seq != self._next_chunk:
            whole = self._flush()
            self._id, self._severity = message.id, message.severity
        self._text += message.text
        self._next_chunk = message.chunk_seq + 1
        self._since_s = now_s
        if len(message.text) < _CHUNK_BYTES:
            whole += self._flush()
        return whole

    def overdue(self, now_s: float) -> list[tuple[int, str]]:
        """Return the text that will not be completed any more, if there is one."""
        return self._flush() if self._id and now_s - self._since_s > _PATIENCE_S else []

    def _flush(self) -> list[tuple[int, str]]:
        whole = [(self._severity, _clean(self._text))] if self._text else []
        self._id, self._text, self._next_chunk = 0, "", 0
        return whole


def encode_text(text: str, severity: int, text_id: int) -> Iterator[Any]:
    """Return the STATUSTEXT messages that carry ``text``, in order.

    Args:
        text: What to say; characters outside ASCII become ``?``.
        severity: MAV_SEVERITY.
        text_id: Tells the chunks of one text from another's, 1 to 65535.
    """
    raw = text.encode("ascii", errors="replace")
    if len(raw) <= _CHUNK_BYTES:
        yield dialect.MAVLink_statustext_message(severity, raw)
        return
    # a text of full chunks only needs an empty one at its end
    for chunk, start in enumerate(range(0, len(raw) + 1, _CHUNK_BYTES)):
        piece = raw[start : start + _CHUNK_BYTES]
        yield dialect.MAVLink_statustext_message(severity, piece, text_id, chunk)


def _clean(text: str) -> str:
    return text.rstrip("\t\r\n ")
