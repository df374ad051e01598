"""A recorded run with certificates, lived through again without any key."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from formation.protocol.order import PositionAttachment
from formation.wire import Sample
from tests.support.fleet import EPOCH
from tests.support.missions import team
from tests.support.recorded import RecordedFleet, all_alike, verify
from tests.support.signed import SignedFleet

TEAM = team({"r0": ["leader"], "r1": ["leader"], "r2": ["r0", "r1"]})


@dataclass
class SignedRecordedFleet(RecordedFleet, SignedFleet):
    """Whose processes have certificates."""

    def passed(self, sample: Sample) -> None:
        self.record.append((sample, EPOCH + self.now))


def unsigned(sender: str, attachment: PositionAttachment) -> PositionAttachment:
    """r0 relays everything without its signature, and from then on forges its mode."""
    if sender != "r0" or attachment.order is None:
        return attachment
    what = attachment.order.model_copy(update={"mode": "stop"})
    return attachment.model_copy(update={"order": what, "signed": "", "signature": ""})


def test_a_signed_run_is_computed_again_without_keys() -> None:
    fleet = SignedRecordedFleet(TEAM, loss=0.1)
    fleet.run(4.0)
    assert any(b"certificate" in (sample.attachment or b"") for sample, _ in fleet.record)
    assert all_alike(verify(TEAM, fleet.record))


@pytest.mark.slow
def test_refused_orders_are_refused_again_without_keys() -> None:
    """r2 hears nothing but refused orders in the end, so it holds; its replica must do the same."""
    fleet = SignedRecordedFleet(TEAM)
    fleet.run(3.0)
    fleet.tamper = unsigned
    fleet.kill("r1")
    fleet.run(2.5)
    assert str(fleet.agents["r2"].decision.reason) == "order not signed by leader: it has no signature"
    verdicts = verify(TEAM, fleet.record)
    assert all_alike(verdicts)
