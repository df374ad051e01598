"""A fleet in memory whose processes have certificates: candidates sign, all verify."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

from formation.agent.core import Agent
from formation.deploy.fleet import authority
from formation.deploy.fleet.authority import Pair
from formation.leader.core import Leader
from formation.mission.model import Mission
from formation.protocol import json_message, order
from formation.protocol.attachment import PositionAttachment
from formation.protocol.order import Order
from formation.topics import POSITION
from formation.transport.security.signing import Authority, Signer, key_id_of
from formation.transport.security.verifying import Verifier
from formation.transport.session import Identity
from formation.wire import Sample
from tests.support.fleet import EPOCH, Fleet

BEGUN = datetime.fromtimestamp(EPOCH, UTC)


@cache
def team_authority() -> Pair:
    """Of all fleets here."""
    return authority.new_authority("team", 365.0, BEGUN)


@cache
def folder() -> Path:
    """Where keys are files."""
    return Path(mkdtemp(prefix="formation-keys-"))


def issued(name: str, days: float = 30.0, by: Pair | None = None) -> Pair:
    """A certificate of the team's authority, or of another."""
    return authority.issue(by or team_authority(), name, None, days, BEGUN)


def identity(pair: Pair, trusted: Pair | None = None) -> Identity:
    """Its files."""
    stem = f"{pair.certificate.serial_number:x}"
    files = [folder() / f"{stem}.{part}.pem" for part in ("ca", "key", "certificate")]
    contents = ((trusted or team_authority()).certificate_pem, pair.key_pem, pair.certificate_pem)
    for file, content in zip(files, contents, strict=True):
        file.write_bytes(content)
    return Identity(*files)


def signer(name: str, pair: Pair | None = None) -> Signer:
    """What signs for a process of this name."""
    return Signer(identity(pair or issued(name)), name, EPOCH)


def verifier(mission: Mission, own: str = "") -> Verifier:
    """What stands in front of one process."""
    authority_file = folder() / "authority.pem"
    authority_file.write_bytes(team_authority().certificate_pem)
    return Verifier(mission, Authority(authority_file).read, key_id_of, own)


def signed(mission: Mission, what: Order, by: Signer) -> dict[str, Any]:
    """The part of a Told that is signed."""
    text = json_message.encode(what).decode()
    return {"signed": text, "signature": by.sign(order.statement(mission.fingerprint, text))}


@dataclass
class SignedFleet(Fleet):
    """As `Fleet`; `unsigned` lists candidates without certificates."""

    unsigned: frozenset[str] = frozenset()
    verifiers: dict[str, Verifier] = field(default_factory=dict)
    signers: dict[str, Signer] = field(default_factory=dict)
    tamper: Callable[[str, PositionAttachment], PositionAttachment] | None = None
    """What becomes of what a process attaches to its position, before its neighbours verify it."""

    def new_agent(self, name: str) -> Agent:
        self.verifiers[name] = verifier(self.mission)
        return Agent(
            self.mission,
            name,
            self.law,
            publisher_id=next(self.publisher_ids),
            certificate=self.verifiers[name].carry,
        )

    def new_leader(self, name: str) -> Leader:
        own = self.mission.leader if name == "leader" else name
        return Leader(
            self.mission, own, publisher_id=next(self.publisher_ids), signer=self.new_signer(name, own)
        )

    def new_signer(self, node: str, own: str) -> Signer | None:
        """A new key, as after a renewal; none for a candidate without certificates."""
        if node in self.unsigned:
            return None
        made = self.signers[node] = signer(own)
        self.verifiers[node] = verifier(self.mission, made.certificate)
        return made

    def __post_init__(self) -> None:
        super().__post_init__()
        self._positions = {POSITION.key(name): name for name in self.mission.names}
        self.leader = self.candidates["leader"] = self.new_leader("leader")
        self.nodes["leader"].core = self.leader

    def passed(self, sample: Sample) -> None:
        """A position is on its way as it is now."""

    def _deliver(self, name: str, sample: Sample) -> None:
        sender = self._positions.get(sample.key)
        if sender is not None and sample.attachment is not None:
            if self.tamper is not None:
                tampered = self.tamper(sender, json_message.decode(PositionAttachment, sample.attachment))
                sample = sample._replace(attachment=json_message.encode(tampered))
            self.passed(sample)
        checked = self.verifiers.get(name)
        if checked is not None:
            clock = EPOCH + sample.arrived + self.nodes[name].clock_error
            sample = checked.check(sample, clock)
        super()._deliver(name, sample)
