"""Verify orders if certificates are configured: before the core, as each message arrives.

    trust      the authority that the links trust, and nothing else. A candidate's certificate comes with the
               positions, so renewed ones need not be distributed, and is relayed once it has been verified.
    rule       an order counts if the candidate of its term has signed the mission's fingerprint and the
               order's exact text. An invalid order is marked (`Sample.unverified`), not removed: positions
               count by the identity of the link on which they arrived.
    cost       each order is verified once, however many neighbours relay it. For each neighbour at most twice
               as many messages are verified as it sends positions; after `STRIKES` wrong ones none for
               `SHUN_TIME` seconds.

Without certificates nothing is signed or verified, and `cryptography` is not imported. A core that runs again
from a recording gets the same marks from the trace, and needs no keys.
"""

from __future__ import annotations

from collections import OrderedDict, deque
from collections.abc import Callable
from types import ModuleType
from typing import TYPE_CHECKING

from formation.mission.model import Mission
from formation.protocol import json_message, order
from formation.protocol.attachment import PositionAttachment
from formation.protocol.election import rank_of
from formation.protocol.order import Order
from formation.topics import POSITION
from formation.transport.bus_config import BusConfig, BusError
from formation.transport.runtime.clock import wall
from formation.transport.runtime.command_line import needs
from formation.transport.session import Identity, identity_of
from formation.wire import BadMessage, Sample

if TYPE_CHECKING:
    from formation.transport.security.signing import Certified, Signer

CARRY_PERIOD = 1.0
"""Period at which a candidate's certificate is relayed [s]."""
STRIKES, STRIKE_MEMORY = 3, 60.0
"""Wrong signatures, and the time [s] in which so many lead to `SHUN_TIME`."""
SHUN_TIME = 5.0
"""Time for which orders of such a neighbour are not verified [s]."""
MAX_CACHED_ORDERS, MAX_CACHED_CERTIFICATES = 64, 4
"""Cached orders that were verified; cached certificates of one candidate."""
MAX_VERIFIED_RATIO = 2.0
"""Most messages to verify of a neighbour, in multiples of the mission's rate of positions."""


class _Unverified(Exception):  # noqa: N818 - the order is what is wrong
    """Why an order does not count, and whether its sender forged it."""

    def __init__(self, why: str, *, forged: bool = True) -> None:
        super().__init__(why)
        self.forged = forged


class _Neighbour:
    """Verifications caused by one neighbour."""

    def __init__(self, rate: float) -> None:
        self._rate = MAX_VERIFIED_RATIO * rate
        self._left, self._since = self._rate, 0.0  # verifications left, and as of when
        self._strikes: deque[float] = deque(maxlen=STRIKES)
        self.shunned_until = float("-inf")

    def afford(self, mono: float) -> bool:
        """Whether one more message may be verified."""
        self._left = min(self._rate, self._left + max(0.0, mono - self._since) * self._rate)
        self._since = mono
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True

    def strike(self, mono: float) -> None:
        """Count a wrong signature."""
        self._strikes.append(mono)
        if len(self._strikes) == STRIKES and mono - self._strikes[0] <= STRIKE_MEMORY:
            self._strikes.clear()
            self.shunned_until = mono + SHUN_TIME


class Verifier:
    """Verifies the orders for one process's core. `check` is for one thread, `carry` for any."""

    def __init__(
        self, mission: Mission, read: Callable[[str], Certified], key_id: Callable[[str], str], own: str = ""
    ) -> None:
        """`read` reads a certificate issued by the fleet's authority, `key_id` a signature's key.

        `own` is the certificate of this process, if it is a candidate.
        """
        self.carried = ""
        """The certificate of the newest verified order."""
        self._mission, self._read, self._key_id = mission, read, key_id
        self._senders = {POSITION.key(name): name for name in mission.names}
        self._neighbours = {name: _Neighbour(mission.robots[name].rate) for name in mission.names}
        self._texts: dict[str, str] = {}  # key id of each certificate that was read
        self._certificates: OrderedDict[str, tuple[Certified, str]] = (
            OrderedDict()
        )  # by key id, last used last
        self._verified: OrderedDict[tuple[str, str], None] = OrderedDict()
        self._new: deque[str] = deque(maxlen=MAX_CACHED_CERTIFICATES)
        self._due = float("-inf")
        if own:
            self._keep(read(own), own)

    def check(self, sample: Sample, wall: float) -> Sample:
        """`sample`, marked if the order on it does not count; `wall` [s since the epoch]."""
        sender = self._senders.get(sample.key)
        if sender is None:
            return sample
        try:
            attachment = json_message.decode(PositionAttachment, sample.attachment or b"")
        except BadMessage:
            return sample  # the core will report it
        try:
            if attachment.certificate:
                self._learn(attachment.certificate, sender, sample.arrived)
            if attachment.order is not None:
                self._judge(attachment, attachment.order, sender, sample.arrived, wall)
        except _Unverified as bad:
            return sample._replace(unverified=f"order not signed by {bad}", forged=bad.forged)
        return sample

    def carry(self, mono: float) -> str:
        """The certificate to send to neighbours now [s, monotonic]; empty for none."""
        if self._new:
            return self._new.popleft()
        if not self.carried or mono < self._due:
            return ""
        self._due = mono + CARRY_PERIOD
        return self.carried

    def _judge(
        self, attachment: PositionAttachment, what: Order, sender: str, mono: float, wall: float
    ) -> None:
        """Raise _Unverified unless the order counts."""
        candidates = self._mission.candidates[rank_of(what.term) :][:1]
        if not candidates:
            raise _Unverified(f"leader: term {what.term} belongs to no candidate")
        signer, exact = candidates[0], (attachment.signed, attachment.signature)
        if not attachment.signed:
            raise _Unverified(f"{signer}: it has no signature")
        if exact in self._verified:
            return
        known = self._certificates.get(self._key_id(attachment.signature))
        if known is None:
            raise _Unverified(f"{signer}: no certificate has come yet for the key that signed", forged=False)
        certified, text = known
        if certified.name != signer:
            raise _Unverified(f"{signer}, but by {certified.name}")
        if not certified.begins <= wall <= certified.ends:
            raise _Unverified(f"{signer}: its certificate is not valid by this robot's clock", forged=False)
        self._afford(sender, signer, mono)
        if not certified.verifies(
            attachment.signature, order.statement(self._mission.fingerprint, attachment.signed)
        ):
            self._neighbours[sender].strike(mono)
            raise _Unverified(f"{signer}: wrong signature, so it is forged or of another mission")
        self._verified[exact] = None
        if len(self._verified) > MAX_CACHED_ORDERS:
            self._verified.popitem(last=False)
        self._certificates.move_to_end(certified.key_id)
        self.carried = text

    def _learn(self, text: str, sender: str, mono: float) -> None:
        """Store a candidate's certificate. Raises _Unverified."""
        if text in self._texts:
            return
        self._afford(sender, "a candidate", mono)
        try:
            certified = self._read(text)
        except ValueError as bad:
            self._neighbours[sender].strike(mono)
            raise _Unverified(f"a candidate: {bad}") from None
        if certified.name not in self._mission.candidates:
            self._neighbours[sender].strike(mono)
            raise _Unverified(f"a candidate: {certified.name[:64]!r} is none in this mission")
        self._keep(certified, text)
        self._new.append(text)

    def _keep(self, certified: Certified, text: str) -> None:
        self._certificates[certified.key_id] = certified, text
        self._texts[text] = certified.key_id
        same = [one for one, _ in self._certificates.values() if one.name == certified.name]
        if len(same) > MAX_CACHED_CERTIFICATES:
            _, forgotten = self._certificates.pop(same[0].key_id)
            del self._texts[forgotten]

    def _afford(self, sender: str, signer: str, mono: float) -> None:
        """Raise _Unverified if the limit of verifications for `sender` is reached."""
        neighbour = self._neighbours[sender]
        if mono < neighbour.shunned_until:
            raise _Unverified(
                f"{signer}: after {STRIKES} wrong signatures nothing of {sender} is"
                f" verified for {SHUN_TIME:g} s"
            )
        if not neighbour.afford(mono):
            raise _Unverified(f"{signer}: {sender} sends more orders than can be verified")


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
