"""Endpoints and names of a mission's processes in the field."""

from __future__ import annotations

import ipaddress
from collections.abc import Mapping
from typing import NamedTuple

from formation.deploy.refusal import Refusal
from formation.mission.model import Mission
from formation.mission.rules import VISITORS
from formation.transport.wiring import named

MONITOR, OPERATOR = VISITORS
"""Processes with a certificate outside the fleet. Both only dial and do not listen."""
PROTOCOL = "tls"


class Host(NamedTuple):
    """Host of a robot's agent, the leader or a standby."""

    address: str
    """IP address or DNS name, without brackets."""
    port: int

    @property
    def ip(self) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
        """The address; None for a name."""
        try:
            return ipaddress.ip_address(self.address)
        except ValueError:
            return None

    @property
    def endpoint(self) -> str:
        """The endpoint in Zenoh's notation."""
        bracketed = f"[{self.address}]" if ":" in self.address else self.address
        return f"{PROTOCOL}/{bracketed}:{self.port}"


def hosts(mission: Mission) -> Mapping[str, Host]:
    """Return the host of each robot and standby, in the order of `members`.

    Raises Refusal for a mission that is not for the field.
    """
    ends = {name: end or "" for name, end in named(mission).items()}
    missing = [name for name, end in ends.items() if not end]
    if missing:
        table = "robots" if missing[0] in mission.robots else "standbys"
        raise Refusal(
            f"mission {mission.name}: {', '.join(missing)} without endpoint; in the field every robot (and"
            f" the leader, and each standby) needs one that the others can dial, such as"
            f" endpoint = {PROTOCOL + '/192.168.1.12:7460'!r} in [{table}.{missing[0]}]"
        )
    for name in VISITORS:
        if name in mission.robots:
            raise Refusal(
                f"mission {mission.name}: no robot of the field can be called {name!r}, for that is what"
                f" the certificate of the {name} says; call it otherwise"
            )
    return {name: _host(name, end) for name, end in ends.items()}


def _host(name: str, endpoint: str) -> Host:
    protocol, _, place = endpoint.partition("/")
    address, _, port = place.rpartition(":")
    host = Host(address.removeprefix("[").removesuffix("]"), int(port))
    where = f"endpoint {endpoint!r} of {name}"
    if protocol != PROTOCOL:
        raise Refusal(f"{where}: must begin with '{PROTOCOL}/', because only that proves the sender")
    if host.ip is not None and host.ip.is_unspecified:
        raise Refusal(f"{where}: must be the address that the others dial, not one that means all of them")
    if "%" in address or (host.ip is None and (":" in host.address or not host.address.isascii())):
        raise Refusal(f"{where}: must be an address without zone, or a name in ASCII: a certificate says it")
    return host
