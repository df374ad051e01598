"""Defects of how an agent takes orders: terms, beats, missions, publishers, signatures."""

from __future__ import annotations

from tests.campaigns.defects.defect import Defect

ORDERS, INBOX, PUBLISHER = "agent/following/orders.py", "agent/inbox.py", "agent/following/publisher.py"
ORDER, VERIFYING = "formation/protocol/order.py", "formation/transport/security/verifying.py"
PROCESS, MAILBOX = "agent/process.py", "formation/transport/mailbox.py"

DEFECTS = (
    Defect(
        "earlier-term-accepted",
        ORDERS,
        "if received.term < max(self.voter.state.voted_term, self._in_force(arrived, now)):",
        "if received.term < self.voter.state.voted_term - self._in_force(arrived, now):",
        "orders of a leader that was replaced count",
        ("signed", "clocks", "muted"),
    ),
    Defect(
        "beat-need-not-rise",
        ORDERS,
        "if rises(received.beat, before[0].beat, arrived - before[1], self._rate):",
        "if received.beat >= before[0].beat:",
        "an order that robots repeat to each other stays alive",
        ("relayed", "killed", "leadercut"),
    ),
    Defect(
        "late-order-accepted",
        ORDERS,
        "            self._check_late(received, arrived)\n",
        "",
        "orders that are too old count",
        ("relayed", "leaderlate"),
    ),
    Defect(
        "unsigned-order-accepted",
        INBOX,
        "if sample.unverified:",
        "if sample.unverified and not sample.key:",
        "forged orders count",
        ("relayed", "signed"),
    ),
    Defect(
        "signature-cached-alone",
        VERIFYING,
        "signer, exact = candidates[0], (attachment.signed, attachment.signature)",
        "signer, exact = candidates[0], (attachment.signature, attachment.signature)",
        "another order under a signature that was seen counts",
        ("relayed", "signed"),
    ),
    Defect(
        "signature-unchecked",
        VERIFYING,
        """if not certified.verifies(
            attachment.signature, order.statement(self._mission.fingerprint, attachment.signed)
        ):""",
        "if not attachment.signature:",
        "an order with a wrong signature counts",
        ("relayed", "signed"),
    ),
    Defect(
        "missing-signature-accepted",
        VERIFYING,
        'raise _Unverified(f"{signer}: it has no signature")',
        "return",
        "an order without a signature counts",
        ("relayed", "signed"),
    ),
    Defect(
        "mission-unchecked",
        INBOX,
        "        neighbour.check_mission(attachment.mission, sample.arrived)\n",
        "",
        "robots follow one of another mission",
        ("mixed",),
    ),
    Defect(
        "repeated-position-accepted",
        PUBLISHER,
        "if attachment.count <= bound.count:",
        "if attachment.count < bound.count - 1_000_000:",
        "repeated positions count",
        ("twice", "relayed"),
    ),
    Defect(
        "second-publisher-accepted",
        PUBLISHER,
        "if wait <= self.limit and not 0 < _term(bound) < _term(attachment) == voted_term:",
        "if wait <= 0.0 and not 0 < _term(bound) < _term(attachment) == voted_term:",
        "two publishers of one robot count in turn",
        ("second",),
    ),
    Defect(
        "freeze-unnoticed",
        INBOX,
        "if last is None or moment - last <= MAX_PAUSE:",
        "if last is None or moment - last <= 1e3 * MAX_PAUSE:",
        "an agent that was frozen acts on what has waited",
        ("robotstall", "muted"),
    ),
    Defect(
        "stops-not-saved-at-once",
        PROCESS,
        "            self._persistence.requested()\n",
        "",
        "a stop is lost if the agent is killed",
        ("power", "full"),
    ),
)
