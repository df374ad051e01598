"""The control laws, one file each: every module of this package defines its `CONTROLLER`.

A new file here is a new law: missions and ``--law`` offer it by the name of its controller. Its step is also
compiled by numba (`formation.simulation.compiled`), so it computes with numbers and these tuples only, and
takes constants from `formation.control` or its own file.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from importlib import import_module
from pkgutil import iter_modules
from types import MappingProxyType, ModuleType

from formation.control.controller import Controller

DEFAULT = "field"
"""Law of a mission that names none."""


def _modules() -> Iterator[ModuleType]:
    for module in sorted(iter_modules(__path__), key=lambda one: one.name):
        yield import_module(f"{__name__}.{module.name}")


def by_name(modules: Iterable[ModuleType]) -> Mapping[str, Controller]:
    """The controllers of `modules`, by name.

    Raises ImportError for a module without one, and for one that gives the name of another's anew.
    """
    laws: dict[str, Controller] = {}
    for module in modules:
        law = getattr(module, "CONTROLLER", None)
        if not isinstance(law, Controller):
            raise ImportError(
                f"{module.__file__}: must define CONTROLLER, a Controller of formation.control", name=__name__
            )
        if law.name in laws:
            other = laws[law.name].step.__module__
            raise ImportError(
                f"{module.__file__}: CONTROLLER: {other} has the name {law.name!r} too: rename one",
                name=__name__,
            )
        laws[law.name] = law
    return MappingProxyType(laws)


LAWS = by_name(_modules())
"""All laws, by name."""
