"""Names and values as lines of text, to be read at 80 columns."""

import textwrap

_WIDTH = 80
_INDENT = 28


def row(name: str, value: str) -> list[str]:
    """Return name and value, the value folded under itself."""
    return textwrap.wrap(
        value,
        _WIDTH,
        initial_indent=f"  {name:<{_INDENT - 2}}",
        subsequent_indent=" " * _INDENT,
    )
