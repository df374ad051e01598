"""Rehearsals and simulations on several processes, of this machine or of a Dask cluster, in order."""

from __future__ import annotations

import gc
import logging
import sys
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from functools import partial
from importlib.metadata import version
from itertools import islice
from typing import Any, TypeVar

from formation.deploy.refusal import Refusal

Item = TypeVar("Item")
Result = TypeVar("Result")
CONNECT_TIMEOUT_SECONDS = 10.0
"""Wait for the scheduler of a cluster [s]."""
MAX_WAITING_ITEMS = 10_000
"""Most items that a cluster is given at once."""
GARBAGE_THRESHOLD = 100_000
"""New objects after which cyclic garbage is searched for: a search costs a fifth of a rehearsal's time."""


def each(
    function: Callable[[Item], Result], items: Iterable[Item], jobs: int = 1, dask: str = ""
) -> Iterator[Result]:
    """Yield `function` of each item in order, computed by `jobs` processes or by the cluster at `dask`.

    What it gives must not depend on where it runs. Raises Refusal for a cluster that cannot be used.
    """
    if dask:
        yield from _on_cluster(function, items, dask)
        return
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


def _on_cluster(function: Callable[[Item], Result], items: Iterable[Item], address: str) -> Iterator[Result]:
    """Compute on the Dask cluster at `address`; what a lost worker had is computed by another one."""
    from distributed import Client  # noqa: PLC0415 - an optional package

    try:
        client: Any = Client(address, timeout=CONNECT_TIMEOUT_SECONDS, set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        raise Refusal(
            f"--dask {address}: no scheduler answers within {CONNECT_TIMEOUT_SECONDS:g} s: {error}"
        ) from None
    with client:
        _check_workers(client, address)
        left = iter(items)
        while batch := list(islice(left, MAX_WAITING_ITEMS)):
            for future in client.map(partial(_quietly, function), batch, pure=False):
                yield future.result()


def _check_workers(client: Any, address: str) -> None:
    """Raise Refusal unless every worker has the versions of this machine, and so computes the same."""
    found = client.run(_versions, on_error="return")
    if not found:
        raise Refusal(f"--dask {address}: the cluster has no workers; start some with: dask worker {address}")
    for worker, versions in sorted(found.items()):
        if versions != _versions():
            here = f"this machine {_versions()}; install the same"
            raise Refusal(f"--dask {address}: worker {worker} has {versions}, {here}")


def _versions() -> str:
    """The versions on which results depend."""
    packages = (f"{name} {version(name)}" for name in ("zenoh-formation", "numpy"))
    return ", ".join(("Python {}.{}".format(*sys.version_info), *packages))


def _quietly(function: Callable[[Item], Result], item: Item) -> Result:
    with _quiet():
        return function(item)


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
