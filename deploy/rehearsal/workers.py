"""Rehearsals on several processes, in order, each with little garbage collection."""

from __future__ import annotations

import gc
import logging
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")
GARBAGE_THRESHOLD = 100_000
"""New objects after which cyclic garbage is searched for: a search costs a fifth of a rehearsal's time."""


def each(function: Callable[[Item], Result], items: Iterable[Item], jobs: int) -> Iterator[Result]:
    """Yield `function` of each item in order; what it gives must not depend on `jobs` processes."""
    if jobs == 1:
        with _quiet():
            yield from map(function, items)
        return
    with ProcessPoolExecutor(jobs, initializer=_prepare) as pool:
        try:
            yield from pool.map(function, items)
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def _prepare() -> None:
    """Silence the log: it is of rehearsed processes. Search for garbage rarely."""
    logging.disable(logging.CRITICAL)
    gc.freeze()
    gc.set_threshold(GARBAGE_THRESHOLD)


@contextmanager
def _quiet() -> Iterator[None]:
    """Prepare this process, and undo that afterwards."""
    before, disabled = gc.get_threshold(), logging.root.manager.disable
    _prepare()
    try:
        yield
    finally:
        gc.set_threshold(*before)
        gc.unfreeze()
        logging.disable(disabled)
