"""The signer and the verifier of orders, if a process's configuration names certificates.

Without certificates nothing is signed or verified, and `cryptography` is not imported.
"""

from __future__ import annotations

from types import ModuleType
from typing import TYPE_CHECKING

from formation.mission.model import Mission
from formation.transport.bus_config import BusConfig, BusError
from formation.transport.runtime.clock import wall
from formation.transport.runtime.command_line import needs
from formation.transport.security.verifying import Verifier
from formation.transport.session import Identity, identity_of

if TYPE_CHECKING:
    from formation.transport.security.signing import Signer


def verifier_of(config: BusConfig, mission: Mission) -> Verifier | None:
    """The verifier of a follower's agent; None without certificates. Raises BusError."""
    identity = identity_of(config)
    return None if identity is None else _verifier(identity, mission)


def signer_of(config: BusConfig, mission: Mission, name: str) -> tuple[Signer, Verifier] | None:
    """The signer of the candidate `name`, and its verifier of relayed orders; None without certificates.

    Raises BusError.
    """
    identity = identity_of(config)
    if identity is None:
        return None
    signing = _signing()
    signer = signing.Signer(identity, name, wall())
    return signer, _verifier(identity, mission, signer.certificate)


def _verifier(identity: Identity, mission: Mission, own: str = "") -> Verifier:
    signing = _signing()
    return Verifier(mission, signing.Authority(identity.authority).read, signing.key_id_of, own)


def _signing() -> ModuleType:
    """The module that signs and verifies. Raises BusError if its dependency is not installed."""
    try:
        from formation.transport.security import signing  # noqa: PLC0415 - a mission without certificates needs none
    except ImportError:
        raise BusError(
            f"transport/link/tls: certificates are configured, and verifying orders {needs('cryptography')}"
        ) from None
    return signing
