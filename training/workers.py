"""Several pieces of work at a time, each in a process of its own with one thread."""

import multiprocessing
import queue
import signal
from collections.abc import Callable, Sequence
from multiprocessing.context import SpawnProcess
from typing import Any, Protocol

import torch

from companion.errors import CompanionError

_LOOK_S = 0.5
"""Between two looks for processes that died without a word."""


class Work(Protocol):
    """Something that a process can do; sent to it by pickle."""

    @property
    def name(self) -> str:
        """Return what it is called; no two are called the same."""
        ...

    @property
    def after(self) -> str | None:
        """Return the name of the work that must be over before."""
        ...

    def do(self, tell: Callable[[int], None], stop: Callable[[], bool]) -> bool:
        """Do it and return whether it is over.

        Args:
            tell: To be told how far it is.
            stop: Asked again and again whether to leave it here.
        """
        ...


def do_all(
    works: Sequence[Work],
    *,
    processes: int,
    told: Callable[[str, int], None],
    stop: Callable[[], bool],
) -> dict[str, str]:
    """Do all work, in order but for what has to wait, and return what is wrong with the rest.

    Args:
        works: Each after the one it waits for.
        processes: How many at a time.
        told: Called with a name and how far that work is.
        stop: Once it says yes, all processes are asked to leave off where they are.

    Returns:
        Names of works that are not over, each with the reason.
    """
    context = multiprocessing.get_context("spawn")
    messages: Any = context.Queue()
    leave_off = context.Event()
    waiting = {work.name: work for work in works}
    running: dict[str, SpawnProcess] = {}
    left: dict[str, str] = {}
    try:
        while waiting or running:
            if stop():
                leave_off.set()
                left |= dict.fromkeys(waiting, "not begun")
                waiting.clear()
            for name in _ready(waiting, running, left)[: max(0, processes - len(running))]:
                process = context.Process(
                    target=_child, args=(waiting.pop(name), messages, leave_off), daemon=True
                )
                process.start()
                running[name] = process
            _listen(messages, running, left, told)
            for name, work in list(waiting.items()):
                if work.after in left:
                    left[name] = f"waits for {work.after}"
                    del waiting[name]
    finally:
        leave_off.set()
        for process in running.values():
            process.join()
    return left


def _ready(
    waiting: dict[str, Work], running: dict[str, SpawnProcess], left: dict[str, str]
) -> list[str]:
    not_over = {*waiting, *running, *left}
    return [name for name, work in waiting.items() if work.after not in not_over]


def _listen(
    messages: Any,
    running: dict[str, SpawnProcess],
    left: dict[str, str],
    told: Callable[[str, int], None],
) -> None:
    """Take in what processes say until nothing is heard for a moment."""
    try:
        name, far, problem = messages.get(timeout=_LOOK_S)
    except queue.Empty:
        for name in [name for name, process in running.items() if process.exitcode is not None]:
            left[name] = f"its process died with exit code {running.pop(name).exitcode}"
        return
    if problem is None:
        told(name, far)
        return
    running.pop(name).join()
    if problem:
        left[name] = problem


def _child(work: Work, messages: Any, leave_off: Any) -> None:
    """Do one work; runs in its own process, where Ctrl-C is left to the parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    torch.set_num_threads(1)  # layers this small lose more to a second thread than they gain
    parent = multiprocessing.parent_process()

    def stop() -> bool:
        return leave_off.is_set() or parent is None or not parent.is_alive()

    try:
        over = work.do(lambda far: messages.put((work.name, far, None)), stop)
        messages.put((work.name, 0, "" if over else "stopped"))
    except CompanionError as error:
        messages.put((work.name, 0, str(error)))
