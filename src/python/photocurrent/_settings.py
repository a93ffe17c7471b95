"""Where results are kept, how the machine is used, where progress goes."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple


class Progress(NamedTuple):
    """How far a node is.

    `done` of `total` items (`unit`) are done; `end` is `None` while it runs, then `"executed"`, `"failed"` or
    `"interrupted"`, after so many `seconds`.
    """

    node: str
    done: int
    total: int
    unit: str
    end: str | None
    seconds: float


#: Hears of progress: a function, `True` for bars of tqdm where it is installed, `None` or `False` for nobody.
Listener = Callable[[Progress], object] | bool | None


@dataclass(frozen=True)
class Settings:
    """What `settings` changes."""

    cache: str | os.PathLike[str] = ".photocurrent"
    threads: int | None = None
    memory: str | None = None
    progress: Listener = None


_current = Settings()


def current() -> Settings:
    """The settings that hold now."""
    return _current


@contextlib.contextmanager
def _restored(before: Settings) -> Iterator[None]:
    global _current
    try:
        yield
    finally:
        _current = before


def settings(
    *,
    cache: str | os.PathLike[str] | None = None,
    threads: int | None = None,
    memory: str | None = None,
    progress: Listener = None,
) -> contextlib.AbstractContextManager[None]:
    """Changes settings from now on, or within a `with` block.

    Parameters
    ----------
    cache
        Folder in which results are kept for later runs; the command's default is `.photocurrent`, and so is
        this package's.
    threads
        Threads for nodes side by side and inside nodes; all cores unless given. The pool inside nodes is made
        once for a process: the first run decides.
    memory
        Memory that data may take, such as `"8GiB"`; half of what is free unless given.
    progress
        A function that is called with a `Progress`, or `True` for bars of tqdm where it is installed.
    """
    global _current
    before = _current
    changes = {"cache": cache, "threads": threads, "memory": memory, "progress": progress}
    given: dict[str, Any] = {name: value for name, value in changes.items() if value is not None}
    _current = replace(before, **given)
    return _restored(before)


_session: tempfile.TemporaryDirectory[str] | None = None


def session() -> Path:
    """A folder of this process for manifests and for arrays as files; it goes away with the process."""
    global _session
    if _session is None:
        _session = tempfile.TemporaryDirectory(prefix="photocurrent-")
    return Path(_session.name)


class _Bars:
    """A bar of tqdm for each node."""

    def __init__(self, tqdm: Any) -> None:
        self._tqdm = tqdm
        self._bars: dict[str, Any] = {}

    def __call__(self, step: Progress) -> None:
        bar = self._bars.get(step.node)
        if bar is None:
            bar = self._bars[step.node] = self._tqdm(desc=step.node, unit=step.unit or "it", leave=False)
        bar.total = step.total or None
        bar.update(step.done - bar.n)
        if step.end is not None:
            self._bars.pop(step.node).close()


def listener(given: Listener = None) -> Callable[..., object] | None:
    """What the engine calls with the fields of a `Progress`."""
    wanted = current().progress if given is None else given
    if wanted is None or wanted is False:
        return None
    if wanted is True:
        try:
            wanted = _Bars(import_module("tqdm.auto").tqdm)
        except ImportError:
            return None
    heard = wanted
    return lambda *fields: heard(Progress(*fields))
