"""``companion run`` in a process of its own, for tests."""

import json
import socket
import subprocess
import sys
import threading
import time

COMPANION = [sys.executable, "-m", "companion.cli"]


def free_port(kind=socket.SOCK_DGRAM):
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Run:
    """One ``companion run --json`` in a process of its own."""

    def __init__(self, *options, record, **how):
        self.process = subprocess.Popen(
            [*COMPANION, "run", "--json", "--record", str(record), *map(str, options)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            **how,
        )
        self.log = []
        self._reader = threading.Thread(target=lambda: self.log.extend(self.process.stderr))
        self._reader.start()

    def wait_for(self, words, timeout_s=30.0):
        deadline = time.monotonic() + timeout_s
        while not any(words in line for line in self.log):
            assert time.monotonic() < deadline, f"never said {words!r}:\n{''.join(self.log)}"
            assert self.process.poll() is None, "".join(self.log)
            time.sleep(0.05)

    def finish(self, timeout_s=90.0):
        out = self.process.stdout.read()
        self.process.wait(timeout_s)
        self._reader.join(5.0)
        assert "Traceback" not in "".join(self.log)
        return json.loads(out) if out else None
