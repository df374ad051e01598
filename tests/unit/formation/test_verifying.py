"""Verification of signed orders: which verify, why others are refused, and its cost."""

from __future__ import annotations

import base64
import itertools
from collections.abc import Callable

import pytest
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec, utils

from formation.deploy.fleet import authority
from formation.mission.file import load
from formation.protocol import json_message
from formation.protocol.attachment import PositionAttachment
from formation.protocol.order import Order
from formation.ros2.messages import Pose, encode
from formation.topics import POSITION
from formation.transport.bus_config import BusError
from formation.transport.security.signing import KEY_ID_BYTES, ORDER_OF_P256, Signer
from formation.transport.security.verifying import SHUN_TIME, STRIKES, Verifier
from formation.wire import Sample
from tests.support.fleet import EPOCH
from tests.support.signed import BEGUN, identity, issued, signed, signer, team_authority, verifier

MISSION, OTHER = load("patrol"), load("six_robots")
LEADER, STANDBY = MISSION.candidates[0], MISSION.candidates[1]
FOLLOWER = MISSION.followers[0]
LED, STOOD, FOLLOWED = signer(LEADER), signer(STANDBY), signer(FOLLOWER)
TERM = int(EPOCH * 1e9) // 64 * 64
"""A term of the leader; the next number is a term of the first standby."""
ID_LENGTH = 4 * KEY_ID_BYTES // 3


def an_order(beat: int = 1, term: int = TERM) -> Order:
    return Order(term=term, beat=beat, mode="run", shape=next(iter(MISSION.shapes)))


class Front:
    """A verifier with its clock; makes the messages that the verifier checks."""

    def __init__(self, *known: Signer) -> None:
        self.verifier: Verifier = verifier(MISSION)
        self.mono, self.period = 0.0, 0.05
        self.verified = 0
        for one in known:
            assert not self.checked(certificate=one.certificate).unverified
        for key, (certified, text) in list(self.verifier._certificates.items()):
            counted = certified._replace(verifies=self._counted(certified.verifies))
            self.verifier._certificates[key] = counted, text

    def checked(self, of: str = FOLLOWER, clock: float = 0.0, **fields: object) -> Sample:
        """The sample that the verifier returns for a message of robot `of` with these fields."""
        self.mono += self.period
        attachment = PositionAttachment.model_validate({"publisher_id": "v", "count": 1, **fields})
        sample = Sample(
            POSITION.key(of), encode(Pose(EPOCH, 0j, 1 + 0j)), json_message.encode(attachment), self.mono
        )
        return self.verifier.check(sample, EPOCH + self.mono + clock)

    def _counted(self, verifies: Callable[[str, bytes], bool]) -> Callable[[str, bytes], bool]:
        def counted(signature: str, message: bytes) -> bool:
            self.verified += 1
            return verifies(signature, message)

        return counted


@pytest.fixture
def front() -> Front:
    """A verifier that knows the certificates of leader and standby."""
    return Front(LED, STOOD)


def test_signed_order_is_verified_only_once(front: Front) -> None:
    fields = signed(MISSION, an_order(), LED)
    for of in (FOLLOWER, *MISSION.followers, LEADER):
        sample = front.checked(of, **fields)
        assert not sample.unverified
        assert json_message.decode(PositionAttachment, sample.attachment or b"").order == an_order()
    assert front.verified == 1


def test_candidate_signs_only_its_own_terms(front: Front) -> None:
    assert not front.checked(**signed(MISSION, an_order(term=TERM + 1), STOOD)).unverified
    by_standby = front.checked(**signed(MISSION, an_order(), STOOD))
    assert by_standby.unverified == f"order not signed by {LEADER}, but by {STANDBY}"
    by_leader = front.checked(**signed(MISSION, an_order(term=TERM + 1), LED))
    assert by_leader.unverified == f"order not signed by {STANDBY}, but by {LEADER}"
    unsigned = front.checked(order=an_order().model_dump())
    assert unsigned.unverified == f"order not signed by {LEADER}: it has no signature"
    assert by_standby.forged
    assert unsigned.forged
    unowned = front.checked(**signed(MISSION, an_order(term=TERM + 60), LED))
    assert "belongs to no candidate" in unowned.unverified


def test_messages_without_orders_pass(front: Front) -> None:
    assert not front.checked(voted_term=TERM).unverified
    other = Sample("robot1/status", b"", None, 0.0)
    assert front.verifier.check(other, EPOCH) is other
    rubbish = Sample(POSITION.key(FOLLOWER), b"", b"{", 0.0)
    assert front.verifier.check(rubbish, EPOCH) is rubbish


@pytest.mark.parametrize(
    "change",
    [
        {"beat": 2}, {"term": TERM + 64}, {"mode": "hold"}, {"scale": 1000.0}, {"route": "elsewhere"},
        {"tuned": {"k_p": 9.0, "k_i": 9.0}}, {"time": 1.0}, {"place": {"x": 1.0, "y": 1.0, "heading": 0.0}},
        {"base_mode": "hold"}, {"holding": True}, {"rotation": 1.0}, {"shape": "other"},
        {"slots": {"mix": {"other": 1.0}, "scale": 1000.0}}, {},
    ],
)  # fmt: skip
def test_changed_order_or_mission_fails_verification(front: Front, change: dict[str, object]) -> None:
    fields = signed(MISSION if change else OTHER, an_order(), LED)
    changed = Order.model_validate({**an_order().model_dump(), **change})
    sample = front.checked(signed=json_message.encode(changed).decode(), signature=fields["signature"])
    assert sample.unverified.endswith("wrong signature, so it is forged or of another mission")


def numbers(signature: str) -> tuple[str, int, int]:
    data = base64.urlsafe_b64decode(signature[ID_LENGTH:] + "==")
    return signature[:ID_LENGTH], int.from_bytes(data[:32]), int.from_bytes(data[32:])


def encoded(key_id: str, data: bytes) -> str:
    return key_id + base64.urlsafe_b64encode(data).rstrip(b"=").decode()


def other_encodings(signature: str) -> dict[str, str]:
    """Other encodings of the same signature, and invalid signatures."""
    key_id, r, s = numbers(signature)
    raw = r.to_bytes(32) + s.to_bytes(32)
    last = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_"
    return {
        "upper s": encoded(key_id, r.to_bytes(32) + (ORDER_OF_P256 - s).to_bytes(32)),
        "DER": encoded(key_id, utils.encode_dss_signature(r, s)),
        "truncated": encoded(key_id, raw[:-1]),
        "half": encoded(key_id, raw[:32]),
        "longer": encoded(key_id, raw + b"\0"),
        "zeros": encoded(key_id, bytes(64)),
        "ones": encoded(key_id, b"\xff" * 64),
        "r = 0": encoded(key_id, bytes(32) + s.to_bytes(32)),
        "unused bits": signature[:-1] + last[last.index(signature[-1]) ^ 1],
        "no signature": key_id,
    }


@pytest.mark.parametrize("kind", list(other_encodings(LED.sign(b""))))
def test_only_one_encoding_of_a_signature_verifies(front: Front, kind: str) -> None:
    fields = signed(MISSION, an_order(), LED)
    sample = front.checked(signed=fields["signed"], signature=other_encodings(fields["signature"])[kind])
    assert sample.forged
    assert not front.checked(**fields).unverified


def test_signature_by_unknown_key_is_not_verified(front: Front) -> None:
    for beat in range(100):
        sample = front.checked(**signed(MISSION, an_order(beat), FOLLOWED))
        assert "no certificate has come yet" in sample.unverified
        assert not sample.forged
    assert front.verified == 0
    assert not front.checked(**signed(MISSION, an_order(), LED)).unverified


STRANGER = authority.new_authority("team", 30.0, BEGUN)
"""Another authority with the name of the fleet's."""
FOLLOWERS = issued(FOLLOWER)
UNTRUSTED = "is not of the fleet's authority"


def issued_by(pair: authority.Pair) -> str:
    """A certificate in the leader's name, issued by `pair`."""
    leaders = authority.issue(pair, LEADER, None, 1.0, BEGUN)
    return Signer(identity(leaders, trusted=pair), LEADER, EPOCH).certificate


def certificate_of_authority() -> str:
    """An authority's own certificate, in the leader's name."""
    lines = authority.new_authority(LEADER, 30.0, BEGUN).certificate_pem.decode().splitlines()[1:-1]
    return base64.urlsafe_b64encode(base64.b64decode("".join(lines))).rstrip(b"=").decode()


@pytest.mark.parametrize(
    ("certificate", "why"),
    [
        (issued_by(STRANGER), UNTRUSTED),
        (issued_by(FOLLOWERS), UNTRUSTED),
        (certificate_of_authority(), ""),
        (FOLLOWED.certificate, f"'{FOLLOWER}' is none in this mission"),
        (LED.certificate[:-4], "certificate cannot be read"),
        (LED.certificate + "A", "order not signed by a candidate"),
        ("AAAA", "certificate cannot be read"),
    ],
    ids=["other authority", "follower's own", "authority", "follower", "cut", "longer", "AAAA"],
)
def test_only_certificates_of_candidates_are_accepted(certificate: str, why: str) -> None:
    front = Front()
    sample = front.checked(certificate=certificate)
    assert why in sample.unverified
    assert sample.forged
    assert not front.verifier._certificates
    assert not front.verifier.carry(1.0)


def test_order_signed_with_expired_certificate_is_refused(front: Front) -> None:
    fields = signed(MISSION, an_order(), LED)
    late = front.checked(clock=31 * 86400.0, **fields)
    assert "not valid by this robot's clock" in late.unverified
    assert not late.forged
    assert "not valid" in front.checked(clock=-86400.0, **fields).unverified
    assert not front.checked(**fields).unverified


def test_renewed_key_and_old_key_both_verify(front: Front) -> None:
    renewed = signer(LEADER)
    assert not front.checked(certificate=renewed.certificate).unverified
    for one, beat in itertools.product((LED, renewed), range(3)):
        assert not front.checked(**signed(MISSION, an_order(beat), one)).unverified


def test_certificate_in_use_is_not_evicted_by_others(front: Front) -> None:
    for beat in range(20):
        assert not front.checked(**signed(MISSION, an_order(beat), LED)).unverified
        assert not front.checked(certificate=signer(LEADER).certificate).unverified
    assert len(front.verifier._certificates) <= 8
    assert len(front.verifier._texts) == len(front.verifier._certificates)


def test_certificates_are_passed_on_at_once_and_every_second() -> None:
    front = Front()
    front.checked(certificate=LED.certificate)
    assert front.verifier.carry(1.0) == LED.certificate
    assert front.verifier.carry(1.0) == ""
    front.checked(certificate=LED.certificate)
    assert front.verifier.carry(1.05) == ""
    front.checked(**signed(MISSION, an_order(), LED))
    carried = [mono / 20 for mono in range(40, 140) if front.verifier.carry(mono / 20)]
    assert carried == [2.0, 3.0, 4.0, 5.0, 6.0]


def test_wrong_signatures_suspend_verification_for_their_sender(front: Front) -> None:
    """1000 within a second; after SHUN_TIME the sender's orders are verified again."""
    front.period = 0.001
    fields, right = (signed(MISSION, an_order(beat), LED) for beat in (1, 5000))
    for beat in range(1000):
        sample = front.checked(
            signed=json_message.encode(an_order(beat + 2)).decode(), signature=fields["signature"]
        )
        assert sample.forged
    assert front.verified == STRIKES
    assert f"nothing of {FOLLOWER} is verified for {SHUN_TIME:g} s" in sample.unverified
    assert front.checked(**fields).unverified
    assert not front.checked(MISSION.followers[1], **fields).unverified
    assert not front.checked(**fields).unverified, "an order that another robot has sent passes"
    assert front.checked(**right).unverified
    front.mono += SHUN_TIME
    assert not front.checked(**right).unverified


def test_replayed_orders_are_verified_at_limited_rate(front: Front) -> None:
    """Each has a right signature: a recording, replayed a hundred times as fast."""
    front.period = 0.0005
    tape = [signed(MISSION, an_order(beat), LED) for beat in range(2000)]
    samples = [front.checked(**fields) for fields in tape]
    rate = MISSION.robots[FOLLOWER].rate
    assert front.verified <= 2.0 * rate + 2.0 * rate * 1.0 + 1
    assert "more orders than can be verified" in samples[-1].unverified
    assert not front.checked(MISSION.followers[1], **signed(MISSION, an_order(5000), LED)).unverified


def test_verifier_keeps_at_most_64_verified_orders(front: Front) -> None:
    for beat in range(300):
        front.checked(**signed(MISSION, an_order(beat), LED))
    assert len(front.verifier._verified) == 64


def test_candidate_verifies_its_own_orders_without_received_certificate() -> None:
    own = verifier(MISSION, LED.certificate)
    attachment = PositionAttachment(publisher_id="v", count=1, **signed(MISSION, an_order(), LED))
    sample = Sample(POSITION.key(FOLLOWER), b"", json_message.encode(attachment), 1.0)
    assert not own.check(sample, EPOCH).unverified


def test_signer_refuses_unusable_identity() -> None:
    mine, day = identity(issued(LEADER)), 86400.0
    for one, now, reason in (
        (identity(issued(FOLLOWER)), EPOCH, f"is the certificate of {FOLLOWER}, not of {LEADER}"),
        (mine, EPOCH + 40 * day, "is not valid now, but until"),
        (identity(issued(LEADER), trusted=STRANGER), EPOCH, UNTRUSTED),
        (mine._replace(key=None), EPOCH, "needs connect_private_key"),
        (mine._replace(key=identity(issued(LEADER)).key), EPOCH, "is not the key of"),
        (mine._replace(key=mine.certificate), EPOCH, "must be a private key"),
    ):
        with pytest.raises(BusError, match=reason):
            Signer(one, LEADER, now)


def test_signature_is_ecdsa_over_mission_fingerprint_and_order() -> None:
    """Checked with the cryptography library alone."""
    pair = issued(LEADER)
    fields = signed(MISSION, an_order(), signer(LEADER, pair))
    _, r, s = numbers(fields["signature"])
    message = f"formation order\n{MISSION.fingerprint}\n{fields['signed']}".encode()
    pair.certificate.public_key()
    key = pair.key.public_key()
    key.verify(utils.encode_dss_signature(r, s), message, ec.ECDSA(hashes.SHA256()))
    assert team_authority().name == "team"
