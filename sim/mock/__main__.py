"""``python -m sim.mock``."""

from sim.mock.cli import main

if __name__ == "__main__":
    raise SystemExit(main())
