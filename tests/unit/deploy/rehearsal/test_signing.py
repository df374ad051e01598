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
from formation.mission.model import Mission
from formation.protocol import json_message, order
from formation.protocol.attachment import PositionAttachment
from formation.protocol.order import Order
from formation.topics import POSITION
from formation.transport.security.verifying import Verifier
from formation.wire import Outgoing, Sample
from tests.campaigns.defects.plan import MISSIONS
from tests.support.examples import slow

PATROL, SIX, TRIO = load("patrol"), load("six_robots"), load(MISSIONS / "trio.toml")
FORGED, REPLAYED = "robot2:forge@3+6 robot1:hold@5+3", "robot1:replay@4+12 leader:kill@7+9"
KEYS = Keys(PATROL)
HELD = Order(term=64, beat=7, mode="hold", shape="line")


def relayed(given: Order, by: str = "leader") -> Outgoing:
    """A position message of robot2 with an order that `by` has signed."""
    text = json_message.encode(given).decode()
    signature = KEYS.signer(by).sign(order.statement(PATROL.fingerprint, text))
    attachment = PositionAttachment(publisher_id="a", count=1, order=given, signed=text, signature=signature)
    return Outgoing(POSITION.key("robot2"), b"", json_message.encode(attachment))


def verified(verifier: Verifier, out: Outgoing) -> Sample:
    return verifier.check(Sample(out.key, out.payload, out.attachment, 1.0), 1.7e9)


def insiders(mission: Mission, faults: str = "", seed: int = 0) -> Verdict:
    return run(Plan(mission, signed=True), seed, [parse(text, mission) for text in faults.split()])


def test_verifier_accepts_only_orders_signed_by_leader() -> None:
    verifier = KEYS.verifier(KEYS.signer("leader").certificate)
    assert not verified(verifier, relayed(HELD)).unverified
    assert verified(verifier, relayed(HELD, "robot2")).unverified


def test_verifier_rejects_every_forgery_of_insider() -> None:
    insider, verifier = Insider(PATROL, "robot2", KEYS), KEYS.verifier(KEYS.signer("leader").certificate)
    recorded = relayed(HELD.model_copy(update={"mode": "run"}))
    insider.tamper(recorded)
    for _ in range(6 * IN_A_ROW + 1):
        tampered = insider.tamper(relayed(HELD))
        assert tampered.attachment is not None
        attachment = json_message.decode(PositionAttachment, tampered.attachment)
        true_one = (attachment.signed, attachment.signature) == _signed(recorded)
        assert attachment.order != HELD
        assert true_one or attachment.order is None or verified(verifier, tampered).unverified


def _signed(out: Outgoing) -> tuple[str, str]:
    attachment = json_message.decode(PositionAttachment, out.attachment or b"")
    return attachment.signed, attachment.signature


def test_insider_leaves_other_keys_unchanged() -> None:
    other = relayed(HELD)._replace(key=POSITION.key("robot3"))
    assert Insider(PATROL, "robot2", KEYS).tamper(other) is other


@pytest.mark.parametrize(
    ("mission", "faults", "seed"),
    [
        (SIX, FORGED, 0),
        *slow((SIX, FORGED, 1), (SIX, FORGED, 2), (TRIO, REPLAYED, 0)),
    ],
)
def test_forging_insider_breaks_no_rule(mission: Mission, faults: str, seed: int) -> None:
    assert insiders(mission, faults, seed).violations == ()


def test_orders_rule_breaks_if_verifier_accepts_everything(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Verifier, "check", lambda _self, sample, _wall: sample)
    assert "orders" in insiders(SIX, FORGED).broken


def test_orders_rule_detects_replayed_order_of_earlier_leader(monkeypatch: pytest.MonkeyPatch) -> None:
    # disable the comparison of an order's term with the voted term and the term in force
    monkeypatch.setattr(orders, "max", lambda *_: 0, raising=False)
    assert "orders" in insiders(TRIO, REPLAYED).broken


def test_unsigned_order_of_leader_breaks_orders_rule(monkeypatch: pytest.MonkeyPatch) -> None:
    begin = Leader.__init__

    def unsigned(self: Leader, *args: object, **options: object) -> None:
        begin(self, *args, **{**options, "signer": None})  # type: ignore[arg-type]

    monkeypatch.setattr(Leader, "__init__", unsigned)
    monkeypatch.setattr(Verifier, "check", lambda _self, sample, _wall: sample)
    assert "orders" in insiders(TRIO).broken


def test_access_rule_reports_message_without_permission(monkeypatch: pytest.MonkeyPatch) -> None:
    lost = POSITION.key("robot1")
    permitted = [one for one in access.permissions(SIX) if (one.receiver, one.key) != ("robot3", lost)]
    monkeypatch.setattr(access, "permissions", lambda _mission: iter(permitted))
    verdict = run(Plan(SIX, seconds=5.0), 0, [])
    (broken,) = [one for one in verdict.violations if one.rule == "access"]
    assert (broken.robot, "robot3" in broken.what, lost in broken.what) == ("leader robot1", True, True)
