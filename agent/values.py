"""How a value that an agent remembers is spelled in JSON, and read again, checked, to the last bit.

Numbers that are not finite are spelled in words.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from enum import StrEnum
from typing import Any, NamedTuple

from pydantic import BaseModel, ValidationError

Json = Any
"""None, bool, int, float, str, and lists and dicts of these."""
_WORDS = {"inf": float("inf"), "-inf": float("-inf"), "nan": float("nan")}
_FINITE = 1.797_693_134_862_315_7e308


class BadMemoryError(ValueError):
    """What is no memory of such an agent; the text names the place and what belongs there."""


class Kind(NamedTuple):
    """One kind of value."""

    said: Callable[[Any], Json]
    """As JSON has it."""
    read: Callable[[Json, str], Any]
    """From JSON at a place, which errors name. Raises BadMemoryError."""


def _is(of: type, what: str) -> Kind:
    def read(said: Json, where: str) -> Any:
        return said if type(said) is of else refuse(said, where, what)

    return Kind(lambda value: value, read)


def refuse(said: Json, where: str, what: str) -> Any:
    """Raise BadMemoryError: at `where` is `said`, and should be `what`."""
    raise BadMemoryError(f"{where}: is {_shown(said)}, must be {what}")


def _shown(said: Json) -> str:
    try:
        return repr(said)[:60]
    except (ValueError, RecursionError):  # a whole number of thousands of digits, or a list as deep
        return f"a {type(said).__name__} too long to show"


def _say_real(value: float) -> Json:
    number = float(value)
    return number if -_FINITE <= number <= _FINITE else str(number)


def _read_real(said: Json, where: str) -> float:
    if type(said) is str and said in _WORDS:
        return _WORDS[said]
    if type(said) is float and -_FINITE <= said <= _FINITE:
        return said
    return float(refuse(said, where, "a number with a point"))


def _say_plane(value: complex) -> Json:
    return [_say_real(value.real), _say_real(value.imag)]


def _read_plane(said: Json, where: str) -> complex:
    if type(said) is list and len(said) == 2:
        return complex(_read_real(said[0], where), _read_real(said[1], where))
    return complex(refuse(said, where, "a vector [x, y]"))


def _read_count(said: Json, where: str) -> int:
    return said if type(said) is int and 0 <= said < 2**63 else refuse(said, where, "a count")


flag = _is(bool, "true or false")
text = _is(str, "text")
count = Kind(int, _read_count)
real = Kind(_say_real, _read_real)
spoken = Kind(bytes.decode, lambda said, where: str(text.read(said, where)).encode())
"""Bytes that are text."""
plane = Kind(_say_plane, _read_plane)


def maybe(kind: Kind) -> Kind:
    """Such a value or None."""
    return Kind(
        lambda value: None if value is None else kind.said(value),
        lambda said, where: None if said is None else kind.read(said, where),
    )


def word(*legal: str, of: type[StrEnum] | None = None) -> Kind:
    """One of a few words."""

    def read(said: Json, where: str) -> str:
        if type(said) is not str or said not in legal:
            refuse(said, where, f"one of {', '.join(legal)}")
        return of(said) if of else str(said)

    return Kind(str, read)


def row(make: Callable[[Iterable[Any]], Any], *kinds: Kind) -> Kind:
    """A tuple, or whatever else `make` makes of values, each of its own kind."""

    def read(said: Json, where: str) -> Any:
        if type(said) is not list or len(said) != len(kinds):
            refuse(said, where, f"a list of {len(kinds)}")
        return make(
            [kind.read(one, f"{where}[{i}]") for i, (kind, one) in enumerate(zip(kinds, said, strict=True))]
        )

    return Kind(lambda value: [kind.said(one) for kind, one in zip(kinds, value, strict=True)], read)


def record(of: type, **kinds: Kind) -> Kind:
    """An object made of named values."""
    names = tuple(kinds)
    as_row = row(lambda values: of(**dict(zip(names, values, strict=True))), *kinds.values())
    return Kind(lambda value: as_row.said([getattr(value, name) for name in names]), as_row.read)


def recent(kind: Kind, most: int | None = None) -> Kind:
    """A deque, of which only the newest are kept."""

    def read(said: Json, where: str) -> deque[Any]:
        if type(said) is not list:
            refuse(said, where, "a list")
        return deque((kind.read(one, f"{where}[{i}]") for i, one in enumerate(said)), maxlen=most)

    return Kind(lambda values: [kind.said(one) for one in values], read)


def several(kind: Kind) -> Kind:
    """A list."""
    as_recent = recent(kind)
    return Kind(as_recent.said, lambda said, where: list(as_recent.read(said, where)))


def by_name(kind: Kind, make: Callable[[dict[str, Any]], Any] = dict) -> Kind:
    """A dict from text, in its order."""

    def read(said: Json, where: str) -> Any:
        if type(said) is not dict:
            refuse(said, where, "an object")
        return make({name: kind.read(one, f"{where}.{name}") for name, one in said.items()})

    return Kind(lambda values: {name: kind.said(one) for name, one in values.items()}, read)


def model(of: type[BaseModel]) -> Kind:
    """A pydantic model."""

    def read(said: Json, where: str) -> BaseModel:
        try:
            return of.model_validate(said)
        except ValidationError as error:
            why = error.errors()[0]["msg"]
        raise BadMemoryError(f"{where}: is {_shown(said)}, no legal {of.__name__}: {why}")

    return Kind(lambda value: value.model_dump(), read)
