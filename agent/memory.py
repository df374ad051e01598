"""All that an agent has learned, as plain JSON: `remember` takes it down, `recall` gives it to another.

An agent's commands follow from its mission, its memory and what it hears from then on. What each class keeps
is in `agent.kept`.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import Any

from agent.core import Agent
from agent.kept import KEPT
from agent.localisation import Localisation
from agent.values import BadMemoryError, Json, refuse

__all__ = ["BadMemoryError", "Json", "recall", "remember"]


def remember(agent: Agent | Localisation, *only: str) -> dict[str, Json]:
    """All that `agent` has learned, or `only` these attributes and parts of it."""
    return dict(_remember(agent, only))


def recall(agent: Agent | Localisation, memory: Json, *, partly: bool = False) -> None:
    """Have `agent`, of the same mission, robot, law and voice, know what another has learned.

    `partly`: where `memory` says nothing it keeps what it knows. Raises BadMemoryError for what is no memory
    of such an agent; `agent` is then as it was.
    """
    learned = list(_learned(agent, memory, "memory", partly=partly))
    for thing, name, value in learned:
        setattr(thing, name, value)


def _remember(thing: Any, only: Collection[str] = ()) -> Json:
    if thing is None:
        return None
    kept = KEPT[type(thing)]
    said = {
        name.lstrip("_"): kind.said(getattr(thing, name))
        for name, kind in kept.memory.items()
        if not only or name.lstrip("_") in only
    }
    for name in kept.parts:
        if only and name.lstrip("_") not in only:
            continue
        part = getattr(thing, name)
        said[name.lstrip("_")] = (
            {key: _remember(one) for key, one in part.items()} if isinstance(part, dict) else _remember(part)
        )
    return said


def _learned(thing: Any, said: Json, where: str, *, partly: bool = False) -> Iterator[tuple[Any, str, Any]]:
    """Each attribute to set, of this thing and its parts: object, name and value. Raises BadMemoryError."""
    kept = KEPT[type(thing)]
    _check_names(said, where, {name.lstrip("_") for name in (*kept.memory, *kept.parts)}, partly=partly)
    for name, kind in kept.memory.items():
        spelled = name.lstrip("_")
        if spelled not in said:
            continue
        yield thing, name, kind.read(said[spelled], f"{where}.{spelled}")
    for name in kept.parts:
        part, spelled = getattr(thing, name), name.lstrip("_")
        if spelled not in said:
            continue
        if part is None:
            if said[spelled] is not None:
                refuse(said[spelled], f"{where}.{spelled}", "null")
            continue
        if not isinstance(part, dict):
            yield from _learned(part, said[spelled], f"{where}.{spelled}")
            continue
        _check_names(said[spelled], f"{where}.{spelled}", set(part))
        for key, one in part.items():
            yield from _learned(one, said[spelled][key], f"{where}.{spelled}.{key}")


def _check_names(said: Json, where: str, names: set[str], *, partly: bool = False) -> None:
    if type(said) is not dict:
        refuse(said, where, "an object")
    if odd := sorted(set(said) - names if partly else names ^ set(said)):
        state = "is missing" if odd[0] in names else "is unknown to this agent"
        raise BadMemoryError(f"{where}.{odd[0]}: {state}")
