"""The control laws, one file each: every module of this package defines its `CONTROLLER`.

A new file here is a new law: missions and ``--law`` offer it by the name of its controller.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib import import_module
from pkgutil import iter_modules
from types import MappingProxyType

from formation.control.controller import Controller

DEFAULT = "field"
"""Law of a mission that names none."""


def _controllers() -> Iterator[Controller]:
    for module in sorted(iter_modules(__path__), key=lambda one: one.name):
        controller: Controller = import_module(f"{__name__}.{module.name}").CONTROLLER
        yield controller


LAWS: Mapping[str, Controller] = MappingProxyType({one.name: one for one in _controllers()})
"""All laws, by name."""
