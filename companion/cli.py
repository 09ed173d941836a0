"""The ``companion`` command."""


def main() -> None:
    """Run the command line."""
    raise SystemExit("companion: not built yet")
