"""Options of a command into its dataclass; what tyro says of a mistake, in one line."""

import contextlib
import io
import re
from collections.abc import Sequence
from typing import TypeVar

import tyro

from companion.errors import UsageError

_T = TypeVar("_T")
_COLOR = re.compile(r"\x1b\[[0-9;]*m")
_OPTION = re.compile(r"--[a-z][a-z-]*")


def parse(kind: type[_T], argv: Sequence[str], prog: str, *, default: _T | None = None) -> _T:
    """Return the options given in ``argv``; ``--help`` prints and exits.

    Raises:
        UsageError: Says in one line what is wrong.
    """
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            if default is None:
                return tyro.cli(kind, args=argv, prog=prog)
            return tyro.cli(kind, args=argv, prog=prog, default=default)
    except SystemExit as ended:
        if not ended.code:
            raise
        raise UsageError(f"{_one_line(said.getvalue())}; {prog} --help says more") from None


def _one_line(box: str) -> str:
    """Return what a box of several lines has to say."""
    parts: list[list[str]] = [[]]
    for line in _COLOR.sub("", box).splitlines():
        text = line.strip().strip("│╭╮╰╯").strip()
        if text.startswith(("─", "━")) and not text.strip("─━ "):
            parts.append([])
        elif text and not text.startswith("─"):
            parts[-1].append(text)
    sentence = " ".join(parts[0]).rstrip(".")
    for part in parts[1:]:
        meant = _OPTION.search(" ".join(part))
        if part and part[0].startswith("Perhaps you meant") and meant:
            sentence += f"; perhaps you meant {meant.group()}"
    return sentence[:1].lower() + sentence[1:]
