"""Signed orders in a rehearsal, and an insider that forges them."""

from __future__ import annotations

import pytest

from formation.agent.following import orders
from formation.deploy.fleet import access
from formation.deploy.rehearsal.faults import parse
from formation.deploy.rehearsal.rehearsal import Plan, Verdict, run
from formation.deploy.rehearsal.signing import IN_A_ROW, Insider, Keys
from formation.leader.core import Leader
from formation.mission.file import load
from formation.protocol import order
from formation.protocol.order import Order, PositionAttachment
from formation.topics import POSITION
from formation.transport.security.verifying import Verifier
from formation.wire import Outgoing, Sample
from tests.campaigns.defects.plan import MISSIONS

PATROL, SIX, TRIO = load("patrol"), load("six_robots"), load(MISSIONS / "trio.toml")
KEYS = Keys(PATROL)
HELD = Order(term=64, beat=7, mode="hold", shape="line")


def relayed(given: Order, by: str = "leader") -> Outgoing:
    """A position of robot2 with an order that a process has signed."""
    text = order.encode(given).decode()
    signature = KEYS.signer(by).sign(order.statement(PATROL.fingerprint, text))
    attachment = PositionAttachment(publisher_id="a", count=1, order=given, signed=text, signature=signature)
    return Outgoing(POSITION.key("robot2"), b"", order.encode(attachment))


def verified(verifier: Verifier, out: Outgoing) -> Sample:
    return verifier.check(Sample(out.key, out.payload, out.attachment, 1.0), 1.7e9)


def insiders(*texts: str, seed: int = 0) -> Verdict:
    return run(Plan(TRIO, signed=True), seed, [parse(text, TRIO) for text in texts])


def test_leader_is_verified_and_another_process_is_not() -> None:
    verifier = KEYS.verifier(KEYS.signer("leader").certificate)
    assert not verified(verifier, relayed(HELD)).unverified
    assert verified(verifier, relayed(HELD, "robot2")).unverified


def test_no_forgery_of_the_insider_is_verified() -> None:
    insider, verifier = Insider(PATROL, "robot2", KEYS), KEYS.verifier(KEYS.signer("leader").certificate)
    recorded = relayed(HELD.model_copy(update={"mode": "run"}))
    insider.tamper(recorded)
    for _ in range(6 * IN_A_ROW + 1):
        tampered = insider.tamper(relayed(HELD))
        assert tampered.attachment is not None
        attachment = order.decode(PositionAttachment, tampered.attachment)
        true_one = (attachment.signed, attachment.signature) == _signed(recorded)
        assert attachment.order != HELD
        assert true_one or attachment.order is None or verified(verifier, tampered).unverified


def _signed(out: Outgoing) -> tuple[str, str]:
    attachment = order.decode(PositionAttachment, out.attachment or b"")
    return attachment.signed, attachment.signature


def test_insider_leaves_other_keys_alone() -> None:
    other = relayed(HELD)._replace(key=POSITION.key("robot3"))
    assert Insider(PATROL, "robot2", KEYS).tamper(other) is other


@pytest.mark.parametrize("seed", [0, *(pytest.param(one, marks=pytest.mark.slow) for one in (1, 2))])
def test_robots_follow_no_forged_order(seed: int) -> None:
    assert insiders("robot1:forge@3+6", "robot2:hold@5+3", seed=seed).violations == ()


def test_forgeries_count_where_nothing_is_verified(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Verifier, "check", lambda _self, sample, _wall: sample)
    assert "orders" in insiders("robot1:forge@3+6", "robot2:hold@5+3").broken


def test_replayed_order_of_an_earlier_leader_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    faults = "robot1:replay@4+12", "leader:kill@7+9"
    assert insiders(*faults).broken == set()
    # the later of the voted term and the term in force, which no order may precede
    monkeypatch.setattr(orders, "max", lambda *_: 0, raising=False)
    assert "orders" in insiders(*faults).broken


def test_unsigned_order_of_a_leader_breaks_the_rule(monkeypatch: pytest.MonkeyPatch) -> None:
    begin = Leader.__init__

    def unsigned(self: Leader, *args: object, **options: object) -> None:
        begin(self, *args, **{**options, "signer": None})  # type: ignore[arg-type]

    monkeypatch.setattr(Leader, "__init__", unsigned)
    monkeypatch.setattr(Verifier, "check", lambda _self, sample, _wall: sample)
    assert "orders" in insiders().broken


def test_missing_access_rule_is_reported_and_refuses_the_message(monkeypatch: pytest.MonkeyPatch) -> None:
    lost = POSITION.key("robot1")
    permitted = [one for one in access.words(SIX) if (one.receiver, one.key) != ("robot3", lost)]
    monkeypatch.setattr(access, "words", lambda _mission: iter(permitted))
    verdict = run(Plan(SIX, seconds=5.0), 0, [])
    (broken,) = [one for one in verdict.violations if one.rule == "access"]
    assert (broken.robot, "robot3" in broken.what, lost in broken.what) == ("leader robot1", True, True)
