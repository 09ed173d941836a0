"""The recorder: ``python -m companion.session.recorder_process FOLDER off|serve|spawn``.

Reads records from standard input until the flying process closes it or dies, and writes the
session folder. Whatever goes wrong with one file, the others are written and the pipe is drained:
flight must not notice. Lines on standard output are for the flying process's log.
"""

import contextlib
import os
import select
import signal
import sys
from pathlib import Path

from companion.clock import now_s, sleep_s
from companion.errors import CompanionError
from companion.session.folder import INPUTS, RECORDING, TLOG
from companion.session.inputs import InputsOutput
from companion.session.outputs import Background, Output, Outputs, TlogOutput
from companion.session.records import RecordReader
from companion.session.viewer import has_display, open_viewer, optimize

_PERIOD_S = 0.2  # between flushes; the live view is that far behind
_NAP_S = 0.05  # waiting for the next record instead, its writer would have to wake us
_READ_BYTES = 1 << 18
_NICENESS = 10  # the control loop comes first


def drain(descriptor: int, outputs: Outputs) -> None:
    """Read records from ``descriptor`` until its end and hand them to ``outputs``."""
    reader = RecordReader()
    due_s = 0.0
    while True:
        if now_s() >= due_s:
            outputs.flush(now_s())
            due_s = now_s() + _PERIOD_S
        readable, _, _ = select.select([descriptor], [], [], 0.0)
        if not readable:
            sleep_s(_NAP_S)
            continue
        data = os.read(descriptor, _READ_BYTES)
        if not data:
            return
        for record in reader.feed(data):
            outputs.write(record)


def _say(text: str) -> None:
    """Tell the flying process, if it still listens."""
    with contextlib.suppress(OSError):
        os.write(sys.stdout.fileno(), f"{text}\n".encode())


def _open_outputs(folder: Path, live: str) -> list[Output]:
    """Open what can be opened and say what cannot."""
    outputs: list[Output] = []
    for name, open_output in ((TLOG, TlogOutput), (INPUTS, InputsOutput)):
        try:
            outputs.append(open_output(folder / name))
        except OSError as error:
            _say(f"no {name}: {error}")
    try:
        from companion.session.streams import file_output, live_output
    except ImportError:
        _say(f'no {RECORDING}: Rerun is not installed (pip install "rerun-sdk==0.41.*")')
        return outputs
    # The rewriting after the flight makes the footer.
    outputs.append(Background(file_output(folder, footer=False)))
    if live != "off":
        announce = _announce_and_open if live == "spawn" else _announce
        outputs.append(Background(live_output(announce)))
    return outputs


def _announce(address: str) -> None:
    _say(f"live view: rerun --connect {address}")


def _announce_and_open(address: str) -> None:
    _announce(address)
    if not has_display():
        _say("no viewer opened: there is no display here")
        return
    try:
        open_viewer("--connect", address)
    except CompanionError as error:
        _say(f"no viewer opened: {error}")


def main() -> None:
    """Record one session."""
    # The end of the pipe is the only end; systemd's watchdog aborts all that a hung loop started.
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGABRT):
        signal.signal(number, signal.SIG_IGN)
    os.nice(_NICENESS)
    os.set_blocking(sys.stdout.fileno(), False)
    folder, live = Path(sys.argv[1]), sys.argv[2]
    outputs = Outputs(_open_outputs(folder, live), _say)
    drain(sys.stdin.fileno(), outputs)
    failed = outputs.close()
    recording, rewritten = folder / RECORDING, folder / f"{RECORDING}.part"
    if RECORDING not in failed and recording.exists() and optimize(recording, rewritten):
        rewritten.replace(recording)
    os._exit(0)  # what is stuck in Rerun would hold a normal exit


if __name__ == "__main__":
    main()
