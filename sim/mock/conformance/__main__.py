"""``python -m sim.mock.conformance FLIGHT.tlog ...``: print how far the mock agrees."""

import argparse
import sys
from pathlib import Path

from companion.errors import CompanionError
from sim.mock.conformance.compare import compare
from sim.mock.conformance.recording import read_recording
from sim.mock.conformance.table import as_text

DEVIATES = 1


def main() -> int:
    """Compare, print the tables, and return 1 if anything deviates by more than its limit."""
    parser = argparse.ArgumentParser(prog="python -m sim.mock.conformance", description=__doc__)
    parser.add_argument("recordings", nargs="+", type=Path, metavar="FLIGHT.tlog")
    holds = True
    try:
        for path in parser.parse_args().recordings:
            rows = compare(read_recording(path))
            print(as_text(path.stem, rows), flush=True)
            holds &= all(row.holds for row in rows)
    except CompanionError as error:
        print(f"conformance: {error}", file=sys.stderr)
        return error.exit_code
    return 0 if holds else DEVIATES


if __name__ == "__main__":
    raise SystemExit(main())
