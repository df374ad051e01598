"""What the tables of a mission file are made of: names, numbers with bounds, and what every table refuses."""

from __future__ import annotations

import ipaddress
import re
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, StringConstraints
from pydantic_core import PydanticCustomError

NAME, TITLE = r"^[a-z][a-z0-9_]*$", r"^[A-Za-z0-9][A-Za-z0-9_-]*$"
Name = Annotated[str, StringConstraints(pattern=NAME, max_length=64)]
Title = Annotated[str, StringConstraints(pattern=TITLE, max_length=64)]
Positive = Annotated[float, Field(gt=0.0, le=1e9)]
NotNegative = Annotated[float, Field(ge=0.0, le=1e9)]
Speed = Annotated[float, Field(gt=0.0, le=1e3)]
"""[m/s] or [rad/s], as far as a message may carry it."""
Metres = Annotated[float, Field(ge=-1e5, le=1e5)]

Namespace = Annotated[str, StringConstraints(max_length=128)]
"""ROS namespace without its leading slash; which spellings are legal is one of the rules."""


def as_tuple(value: Any) -> Any:
    """A list as TOML has it, as a tuple; all else as it is."""
    return tuple(value) if isinstance(value, list) else value


Point = Annotated[tuple[Metres, Metres], BeforeValidator(as_tuple)]
"""x, y [m]."""


class Table(BaseModel):
    """A table of the mission file: frozen, unknown keys refused, nothing coerced, every number finite."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


_ENDPOINT = re.compile(r"(tcp|tls|udp|quic)/\[?(?P<host>[^/\s\[\]]+)\]?:(?P<port>[0-9]{1,5})")


def _endpoint(value: str) -> str:
    found = _ENDPOINT.fullmatch(value)
    if found is None or not 1 <= int(found["port"]) <= 65535 or not _is_host(found["host"]):
        raise PydanticCustomError(
            "endpoint",
            "Input should be tcp, tls, udp or quic, an address and a port from 1 to 65535,"
            " such as 'tls/192.168.1.12:7460'",
        )
    return value


def _is_host(text: str) -> bool:
    """Whatever looks like an IPv4 address is one; the rest is names, and IPv6."""
    if not re.fullmatch(r"[0-9.]+", text):
        return True
    try:
        ipaddress.IPv4Address(text)
    except ValueError:
        return False
    return True


Endpoint = Annotated[str, AfterValidator(_endpoint)]
"""Where a process listens, as Zenoh writes it: protocol, address and port."""
