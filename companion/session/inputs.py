"""``inputs.bin``: the start of the session and the blocks of its journal, compressed one by one.

A magic line, then blocks: the length as four bytes big-endian, then zlib data that holds records
as they crossed the pipe (``records.encode_record``). A file that is cut off loses its last block.
"""

import zlib
from dataclasses import dataclass
from pathlib import Path

import msgspec

from companion.errors import RefusedError
from companion.session.folder import INPUTS
from companion.session.outputs import Sync
from companion.session.records import (
    Inputs,
    Record,
    RecordReader,
    SessionEnd,
    SessionStart,
    encode_record,
)
from companion.session.summary import Summary

_MAGIC = b"companion inputs 1\n"
_LENGTH_BYTES = 4
_LEVEL = 1  # a third of the size at a tenth of the time of the default


class InputsOutput:
    """Writes ``inputs.bin``."""

    name = INPUTS

    def __init__(self, path: Path) -> None:
        """Create the file.

        Raises:
            OSError: If the folder cannot be written to.
        """
        self._file = path.open("wb")
        self._file.write(_MAGIC)
        self._sync = Sync(path)

    def write(self, record: Record) -> None:
        """Take one record; only the start, the journal and the end matter here."""
        if isinstance(record, SessionStart | Inputs | SessionEnd):
            data = zlib.compress(encode_record(record), _LEVEL)
            self._file.write(len(data).to_bytes(_LENGTH_BYTES, "big") + data)

    def flush(self, now_s: float) -> None:
        """Hand what there is to the system, and now and then to the disk."""
        self._file.flush()
        self._sync(now_s)

    def close(self) -> None:
        """Finish the file."""
        self._file.close()


@dataclass(frozen=True, slots=True)
class RecordedInputs:
    """What ``inputs.bin`` holds."""

    start: SessionStart
    journal: bytes
    frames: int
    """That ``flight.tlog`` must hold at least."""
    summary: Summary | None
    """How the session ended; ``None`` if the program was killed."""


def read_inputs(path: Path) -> RecordedInputs:
    """Read ``inputs.bin`` back.

    Raises:
        RefusedError: If it is no such file, or the recorder has lost a part of it.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise RefusedError(
            f"cannot read {path}: {error.strerror}; without it nothing can be replayed"
        ) from error
    if not content.startswith(_MAGIC):
        raise RefusedError(f"{path} is not a record of inputs of this version")
    start, summary, blocks = None, None, []
    for record in _records(path, content):
        match record:
            case SessionStart():
                start = record
            case Inputs():
                blocks.append(record)
            case SessionEnd():
                summary = record.summary
    if start is None or not blocks:
        raise RefusedError(f"{path} holds no flight: the program ended before it began")
    if [block.number for block in blocks] != list(range(len(blocks))):
        raise RefusedError(
            f"{path} has gaps: the recorder could not keep up and dropped records, so the flight "
            "cannot be replayed exactly"
        )
    journal = b"".join(block.data for block in blocks)
    return RecordedInputs(start, journal, blocks[-1].frames, summary)


def _records(path: Path, content: bytes) -> list[Record]:
    reader, records, at = RecordReader(), [], len(_MAGIC)
    while at + _LENGTH_BYTES <= len(content):
        begin = at + _LENGTH_BYTES
        at = begin + int.from_bytes(content[at:begin], "big")
        if at > len(content):
            break
        try:
            records += reader.feed(zlib.decompress(content[begin:at]))
        except (zlib.error, msgspec.DecodeError) as error:
            raise RefusedError(f"{path} is damaged: {error}") from error
    return records
