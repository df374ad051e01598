"""Where a process of a mission listens, as Zenoh writes it: protocol, address and port."""

from __future__ import annotations

import ipaddress
import re
from typing import Annotated

from pydantic import AfterValidator
from pydantic_core import PydanticCustomError

_ENDPOINT = re.compile(r"(tcp|tls|udp|quic)/\[?(?P<host>[^/\s\[\]]+)\]?:(?P<port>[0-9]{1,5})")


def _checked(value: str) -> str:
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


Endpoint = Annotated[str, AfterValidator(_checked)]
