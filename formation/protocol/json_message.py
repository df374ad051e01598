"""Messages in JSON, read strictly: what all of them share."""

from __future__ import annotations

from functools import lru_cache
from typing import Annotated, ClassVar, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, ValidationError

from formation.wire import BadMessage

MAX_ORDER_BYTES = 1024
"""Greatest size of an order, reply or ballot that is read."""

Count = Annotated[int, Field(ge=0, lt=2**63)]
Name = Annotated[str, StringConstraints(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9_.-]+$")]
Id = Annotated[str, StringConstraints(max_length=64, pattern=r"^[A-Za-z0-9_.-]*$")]
Tag = Annotated[str, StringConstraints(max_length=16, pattern=r"^[A-Za-z0-9]*$")]
Scale = Annotated[float, Field(allow_inf_nan=False, ge=1e-3, le=1e3)]


class JsonMessage(BaseModel):
    """A message, or a part of one."""

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid")
    longest: ClassVar[int] = MAX_ORDER_BYTES
    """Greatest size that is read [bytes]."""
    read_twice: ClassVar[bool] = False
    """Whether it may be verified as it arrives, and read again in a step."""

    @property
    def packed(self) -> set[str] | None:
        """Fields that are not sent, because another one contains them as text; None for none."""
        return None

    def opened(self) -> Self:
        """Decode the parts that are packed as text. Raises ValidationError."""
        return self


M = TypeVar("M", bound=JsonMessage)


def encode(message: JsonMessage) -> bytes:
    """Encode as JSON, UTF-8; defaults are omitted, so that older robots understand a stop."""
    return message.model_dump_json(exclude_defaults=True, exclude=message.packed).encode()


def _read(cls: type[M], data: bytes) -> M:
    return cls.model_validate_json(data).opened()


_read_once = lru_cache(64)(_read)
"""Orders decoded for verification, on the receive thread, are not decoded again in a step."""


def decode(cls: type[M], data: bytes) -> M:
    """Read `data` strictly. Raises BadMessage, and nothing else, for anything that is not exactly a `cls`."""
    if len(data) > cls.longest:
        raise BadMessage(f"{cls.__name__}: {len(data)} bytes, at most {cls.longest} are read")
    try:
        return _read_once(cls, data) if cls.read_twice else _read(cls, data)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False, include_context=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        raise BadMessage(f"{cls.__name__}: {where + ': ' if where else ''}{first['msg']}") from None
