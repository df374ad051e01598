"""The control laws, one file each: every module of this package defines its `CONTROLLER`.

A new file here is a new law: missions and ``--law`` offer it by the name of the file. Its step is also
compiled by numba (`formation.simulation.compiled`), so it computes with numbers and these tuples only, and
takes constants from `formation.control` or its own file.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from importlib import import_module
from pkgutil import iter_modules
from types import MappingProxyType, ModuleType
from typing import NoReturn

from formation.control.controller import Controller
from formation.control.observer import INNOVATION

DEFAULT = "field"
"""Law of a mission that names none."""


def controller(module: ModuleType, name: str) -> Controller:
    """Return the law of a `module` called `name`. Raises ImportError."""
    law = getattr(module, "CONTROLLER", None)
    if not isinstance(law, Controller):
        raise ImportError("must define CONTROLLER, a Controller of formation.control")
    if law.name != name:
        raise ImportError(f"the name of its CONTROLLER is {law.name!r}, must be {name!r} as the file's")
    return law


def load(names: Iterable[str]) -> tuple[Mapping[str, Controller], Mapping[str, str]]:
    """Return the laws of these modules of the package, and why each other one cannot be used.

    A law in the making must not keep an operator from stopping robots that another one drives.
    """
    laws, unusable = dict[str, Controller](), dict[str, str]()
    for name in sorted(names):
        try:
            laws[name] = controller(import_module(f"{__name__}.{name}"), name)
        except (Exception, SystemExit) as error:  # noqa: BLE001 - whatever a user's file raises
            cause = f"{type(error).__name__}: {error}".partition("\n")[0]
            unusable[name] = f"{name}.py cannot be used: {cause}"
    return MappingProxyType(laws), MappingProxyType(unusable)


LAWS, UNUSABLE = load(one.name for one in iter_modules(__path__))
"""All laws, by name; and why other files of this package are none."""


def why_unusable(name: str) -> str | None:
    """Return why the law `name` cannot drive, in words; None if it can."""
    if name in LAWS:
        return None
    return UNUSABLE.get(name) or f"law {name!r}: must be one of {', '.join(LAWS)}"


def law_of(name: str) -> Controller:
    """Return the law `name`; for one in `UNUSABLE` a stand-in, the step of which raises ImportError."""

    def step(*_: object) -> NoReturn:
        raise ImportError(why_unusable(name))

    return LAWS.get(name) or Controller(name, step, INNOVATION)
