"""Signed orders in a rehearsal, and insiders that forge them or relay recorded ones.

Keys depend on nothing but the names, and a signature is a keyed hash: ECDSA would differ between two runs.
What is signed, verified and relayed, and when, is the production's.
"""

from __future__ import annotations

import hashlib
import hmac
from typing import NamedTuple

from formation.mission.model import Mission
from formation.protocol import json_message, order
from formation.protocol.attachment import PositionAttachment
from formation.protocol.order import Order
from formation.topics import POSITION
from formation.transport.security.signing import BadSignature, Certified, encoded, key_id_of
from formation.transport.security.verifying import Verifier
from formation.wire import Outgoing

CERTIFICATE_BYTES = 450
"""About as large as a real one."""
LEAP = 1_000_000
"""A forged order's beat is ahead by this."""
IN_A_ROW = 20
"""Positions with one kind of forgery, before the next kind: a beat counts only if it rises twice."""
VALID_FROM, VALID_UNTIL = 0.0, 1e12
"""Of all certificates [s since the epoch]."""


class RehearsedSigner(NamedTuple):
    """The key of one process: a `formation.leader.core.Signer`."""

    certificate: str
    key: bytes

    def sign(self, message: bytes) -> str:
        """Sign `message`."""
        digest = hmac.digest(self.key, message, "sha256")
        return _key_id(self.certificate) + encoded(digest + hmac.digest(self.key, digest, "sha256"))


class Keys:
    """The keys and certificates of a mission's processes."""

    def __init__(self, mission: Mission) -> None:
        self._mission = mission
        self._names = {self.signer(name).certificate: name for name in (*mission.names, *mission.standbys)}

    def signer(self, name: str) -> RehearsedSigner:
        """The key of the process `name`."""
        content = f"certificate of {name}\n".encode().ljust(CERTIFICATE_BYTES, b".")
        return RehearsedSigner(encoded(content), hashlib.sha256(content).digest())

    def verifier(self, own: str = "") -> Verifier:
        """What checks orders before a process; `own` is its certificate, if it is a candidate."""
        return Verifier(self._mission, self._read, key_id_of, own)

    def insider(self, name: str) -> Insider:
        """The robot `name` as an insider."""
        return Insider(self._mission, name, self)

    def _read(self, text: str) -> Certified:
        """Raises BadSignature."""
        name = self._names.get(text)
        if name is None:
            raise BadSignature("certificate is not of the fleet's authority")
        signer = self.signer(name)
        return Certified(
            name,
            _key_id(text),
            VALID_FROM,
            VALID_UNTIL,
            lambda signature, message: signer.sign(message) == signature,
        )


class Insider:
    """Forges the orders that one robot relays, in each known way in turn."""

    def __init__(self, mission: Mission, name: str, keys: Keys) -> None:
        self._mission, self._key, self._own = mission, POSITION.key(name), keys.signer(name)
        self._count = 0
        self._recorded: PositionAttachment | None = None  # the first run that was relayed

    def tamper(self, out: Outgoing) -> Outgoing:
        """Return `out` with a forged order, if it is this robot's position."""
        attachment = _relayed(out, self._key)
        if attachment is None or attachment.order is None:
            return out
        if self._recorded is None and attachment.order.mode == "run":
            self._recorded = attachment
        self._count += 1
        return out._replace(attachment=json_message.encode(self._forged(attachment, attachment.order)))

    def _forged(self, attachment: PositionAttachment, true: Order) -> PositionAttachment:
        run = {"mode": "run", "base_mode": "run", "holding": False}
        ahead = true.model_copy(update={"beat": true.beat + LEAP + self._count, **run})
        later = ahead.model_copy(update={"term": true.term + 64 * self._count})
        larger = ahead.model_copy(update={"scale": 3.0})
        match self._count // IN_A_ROW % 6:
            case 0:  # another text under the leader's signature
                return _with(attachment, ahead, attachment.signature)
            case 1:
                return _with(attachment, larger, self._signature(larger))
            case 2:
                return _with(attachment, later, self._signature(later))
            case 3:
                return attachment.model_copy(update={"order": ahead, "signed": "", "signature": ""})
            case 4:
                alone = {"order": None, "signed": "", "signature": "", "certificate": self._own.certificate}
                return attachment.model_copy(update=alone)
        return _with_order_of(attachment, self._recorded or attachment)

    def _signature(self, forged: Order) -> str:
        text = json_message.encode(forged).decode()
        return self._own.sign(order.statement(self._mission.fingerprint, text))


class Replayer:
    """Relays true orders, and later the same again: an insider with a recording."""

    def __init__(self, name: str) -> None:
        self._key = POSITION.key(name)
        self._recorded: list[PositionAttachment] = []
        self._next: int | None = None

    def play(self) -> None:
        """Relay what was recorded from now on."""
        self._next = 0

    def tamper(self, out: Outgoing) -> Outgoing:
        """Record `out`, or return it with a recorded order, if it is this robot's position."""
        attachment = _relayed(out, self._key)
        if attachment is None or attachment.order is None:
            return out
        if self._next is None:
            self._recorded.append(attachment)
        if self._next is None or self._next >= len(self._recorded):
            return out
        old, self._next = self._recorded[self._next], self._next + 1
        return out._replace(attachment=json_message.encode(_with_order_of(attachment, old)))


def _relayed(out: Outgoing, key: str) -> PositionAttachment | None:
    """The attachment with the order that `out` relays, if it is a position of this `key`."""
    if out.key != key or not out.attachment:
        return None
    return json_message.decode(PositionAttachment, out.attachment)


def _with_order_of(attachment: PositionAttachment, old: PositionAttachment) -> PositionAttachment:
    return attachment.model_copy(
        update={"order": old.order, "signed": old.signed, "signature": old.signature}
    )


def _with(attachment: PositionAttachment, forged: Order, signature: str) -> PositionAttachment:
    return attachment.model_copy(
        update={"order": forged, "signed": json_message.encode(forged).decode(), "signature": signature}
    )


def _key_id(certificate: str) -> str:
    return key_id_of(encoded(hashlib.sha256(certificate.encode()).digest()))
