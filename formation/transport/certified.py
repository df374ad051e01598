"""What a process needs to sign orders and to verify them, if its configuration names certificates.

Without certificates nothing is signed or verified, and `cryptography` is not imported.
"""

from __future__ import annotations

from types import ModuleType
from typing import TYPE_CHECKING

from formation.mission import Mission
from formation.transport.bus_config import BusConfig, BusError
from formation.transport.clock import wall
from formation.transport.session import Identity, identity_of
from formation.transport.verifying import Verifier

if TYPE_CHECKING:
    from formation.transport.signing import Signer


def verifier_of(config: BusConfig, mission: Mission) -> Verifier | None:
    """What a follower's agent verifies orders with; None without certificates. Raises BusError."""
    identity = identity_of(config)
    return None if identity is None else _verifier(identity, mission)


def signer_of(config: BusConfig, mission: Mission, name: str) -> tuple[Signer, Verifier] | None:
    """What the candidate `name` signs its orders with, and verifies those that come back; None without.

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
    """The module that signs and verifies. Raises BusError where what it needs is not installed."""
    try:
        from formation.transport import signing  # noqa: PLC0415 - a mission without certificates needs none
    except ImportError:
        raise BusError(
            "transport/link/tls: certificates are configured, and orders cannot be verified without the"
            " package cryptography: install formation[field]"
        ) from None
    return signing
