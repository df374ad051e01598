"""An insider, a follower's process with a valid certificate of its own, relays forged orders."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

import pytest

from formation.control.unicycle import AT_REST
from formation.mission.model import Mission
from formation.protocol import json_message
from formation.protocol.attachment import PositionAttachment
from formation.protocol.order import Order, Slots, Tuned
from formation.protocol.status import AgentState
from tests.support.examples import slow
from tests.support.fleet import EPOCH, Fleet
from tests.support.missions import team
from tests.support.signed import SignedFleet, signed, signer

TEAM = team({"r0": ["leader"], "r1": ["leader"], "r2": ["r0", "r1"], "r3": ["r0"], "r4": ["r2", "r3"]})
INSIDER, RECEIVES_IT, OTHERS = "r0", ("r2", "r3"), ("r1", "r2", "r3", "r4")
RUN = {"mode": "run", "base_mode": "run", "holding": False}
NO_SIGNATURE = {"signed": "", "signature": ""}
OWN_KEY = signer(INSIDER)
Forgery = Callable[[SignedFleet, PositionAttachment], PositionAttachment]


def held(fleet: SignedFleet) -> SignedFleet:
    """The fleet after it has driven and is held by its leader."""
    fleet.run(3.0)
    assert fleet.states == {AgentState.RUN}
    assert fleet.ask("leader", "hold").ok
    fleet.run(0.6)
    assert fleet.states == {AgentState.HOLD}
    return fleet


def unprotected(mission: Mission = TEAM) -> SignedFleet:
    """A fleet without certificates."""
    fleet = SignedFleet(mission, seed=1, unsigned=frozenset({"leader"}))
    fleet.verifiers.clear()
    return fleet


def tamper(fleet: SignedFleet, forgery: Forgery) -> None:
    """Have the insider relay forged orders from now on."""
    fleet.tamper = lambda sender, attached: (
        forgery(fleet, attached) if sender == INSIDER and attached.order is not None else attached
    )


def replay(
    fleet: SignedFleet, tape: Iterable[PositionAttachment], **changes: object
) -> Iterator[PositionAttachment]:
    """Have the insider relay the recorded run orders from now on; return those not yet relayed."""
    left = iter([one for one in tape if one.order and one.order.mode == "run"])

    def replayed(sender: str, attachment: PositionAttachment) -> PositionAttachment:
        old = next(left, None) if sender == INSIDER else None
        if old is None:
            return attachment
        recorded = {"signed": old.signed, "signature": old.signature, "order": old.order}
        return attachment.model_copy(update={"certificate": "", **recorded, **changes})

    fleet.tamper = replayed
    return left


def moved(fleet: Fleet, names: Iterable[str], since: float) -> list[str]:
    """Robots with a command other than zero velocity since then."""
    return [name for name in names if not set(fleet.commands_since(name, since)) <= {AT_REST}]


def run_ahead(attached: PositionAttachment, **changes: object) -> PositionAttachment:
    """The attachment with a run order ahead of the leader's beat, and with its old signature."""
    assert attached.order is not None
    what = attached.order.model_copy(update={"beat": 1_000_000 + attached.count, **RUN, **changes})
    signed_text = json_message.encode(what).decode() if attached.signed else ""
    return attached.model_copy(update={"order": what, "signed": signed_text})


def later_term(fleet: SignedFleet, attachment: PositionAttachment) -> PositionAttachment:
    return run_ahead(attachment, term=int((EPOCH + fleet.now) * 1e9) // 64 * 64)


def unsigned(_: SignedFleet, attachment: PositionAttachment) -> PositionAttachment:
    return run_ahead(attachment).model_copy(update=NO_SIGNATURE)


def unsigned_later_term(fleet: SignedFleet, attachment: PositionAttachment) -> PositionAttachment:
    return later_term(fleet, attachment).model_copy(update=NO_SIGNATURE)


def signed_by_itself(_: SignedFleet, attachment: PositionAttachment) -> PositionAttachment:
    own = run_ahead(attachment).order
    assert own is not None
    certificate = OWN_KEY.certificate if attachment.count % 2 else ""
    fields = {} if certificate else signed(TEAM, own, OWN_KEY)
    return attachment.model_copy(update={"order": None, **NO_SIGNATURE, "certificate": certificate, **fields})


def changed(**changes: object) -> Forgery:
    return lambda _, attachment: run_ahead(attachment, **changes)


other_gains = changed(tuned=Tuned(k_p=5.0, k_i=1.0))
FORGERIES: tuple[Forgery, ...] = (
    changed(), later_term, unsigned, unsigned_later_term, signed_by_itself, other_gains,
    changed(scale=1000.0, slots=Slots(mix={"row": 1.0}, scale=1000.0)),
    changed(route="elsewhere", time=1e6),
)  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("forgery", FORGERIES)
def test_forged_order_moves_no_robot_and_status_names_forger(forgery: Forgery) -> None:
    fleet = held(SignedFleet(TEAM, seed=1))
    start = fleet.now
    tamper(fleet, forgery)
    fleet.run(2.0)
    assert moved(fleet, OTHERS, start) == []
    assert {fleet.agents[name].decision.state for name in OTHERS} == {AgentState.HOLD}
    for name in RECEIVES_IT:
        assert fleet.status(name).forged[INSIDER].startswith("order not signed by")
        assert f"{INSIDER} relayed forged orders" in fleet.message(name)
    for name in ("r1", "r4"):
        assert "forged" not in fleet.message(name)
    assert INSIDER in fleet.leader.forgers(fleet.now)


@pytest.mark.parametrize("forgery", [unsigned, other_gains])
def test_forged_order_moves_robots_without_certificates(forgery: Forgery) -> None:
    """This is the limit of a mission without certificates; it shows that forgeries have an effect."""
    fleet = held(unprotected())
    tamper(fleet, forgery)
    fleet.run(2.0)
    assert AgentState.RUN in {fleet.agents[name].decision.state for name in OTHERS}


def test_leader_received_directly_overrides_relays_ahead_of_it() -> None:
    """Without certificates, a robot that receives the leader itself follows the leader's own orders."""
    fleet = held(unprotected(team({"r0": ["leader"], "r1": ["leader", "r0"]})))
    tamper(fleet, unsigned_later_term)
    fleet.run(3.0)
    assert fleet.agents["r1"].decision.state is AgentState.HOLD
    assert "ahead of the leader" in fleet.agents["r1"].inbox.state.last_dropped["r0/position"]


def test_leader_raises_alarm_at_relays_ahead_of_its_beat() -> None:
    fleet = held(unprotected())
    tamper(fleet, unsigned)
    fleet.run(1.0)
    (note,) = [note for note in fleet.leader.notes if "ALARM" in note]
    assert note.startswith("ALARM: r0 relays a forged order: it is ahead of the leader: beat 1000")
    assert fleet.leader.mode == "hold"


def taped(fleet: SignedFleet) -> list[PositionAttachment]:
    """A growing list of the signed attachments that the insider sends from now on."""
    tape: list[PositionAttachment] = []

    def keep(sender: str, attachment: PositionAttachment) -> PositionAttachment:
        if sender == INSIDER and attachment.signed:
            tape.append(attachment)
        return attachment

    fleet.tamper = keep
    return tape


def test_replayed_run_orders_do_not_end_hold() -> None:
    """Run orders with valid signatures are relayed again after the leader's hold."""
    fleet = SignedFleet(TEAM, seed=1)
    tape = taped(fleet)
    start = held(fleet).now
    left = replay(fleet, tape)
    fleet.run(2.0)
    assert next(left, None) is not None
    assert moved(fleet, OTHERS, start) == []


@pytest.mark.slow
def test_replayed_orders_of_earlier_term_change_nothing() -> None:
    """The leader ended in its second term; orders of the first are replayed 7 s later."""
    fleet = SignedFleet(TEAM, seed=1)
    tape = taped(fleet)
    fleet.run(3.0)
    fleet.restart("leader")
    first = tuple(tape)
    fleet.run(3.0)
    fleet.leader.halt(fleet.moment, "SIGINT")
    fleet.kill("leader")
    fleet.run(7.0)
    start, obeyed = fleet.now, {name: fleet.agents[name].orders.newest for name in OTHERS}
    replay(fleet, first, term=0, stale=False)
    fleet.run(2.0)
    assert {name: fleet.agents[name].orders.newest for name in OTHERS} == obeyed
    assert "order of an earlier term" in fleet.agents["r2"].inbox.state.last_dropped["r0/position"]
    assert moved(fleet, OTHERS, start) == []


def terms(fleet: SignedFleet) -> set[int]:
    """The terms that the robots obey."""
    return {agent.orders.newest.term if agent.orders.newest else 0 for agent in fleet.agents.values()}


@pytest.mark.parametrize(("before", "after"), [(20.0, 0.0), *slow((1.0, 0.0), (0.0, -1.0))])
def test_robots_obey_leader_restarted_with_clock_set_back(before: float, after: float) -> None:
    """The leader's clock was `before` hours ahead, then `after`; it restarts without saved state."""
    fleet = SignedFleet(TEAM, seed=1)
    fleet.nodes["leader"].clock_error = 3600.0 * before
    fleet.run(3.0)
    assert all(agent.orders.newest for agent in fleet.agents.values())
    fleet.kill("leader")
    fleet.run(6.0)
    fleet.nodes["leader"].clock_error = 3600.0 * after
    fleet.restart("leader")
    fleet.run(8.0)
    assert fleet.states == {AgentState.RUN}
    assert terms(fleet) == {fleet.leader.term}


@pytest.mark.slow
def test_robots_with_different_terms_reach_common_term() -> None:
    """The leader restarts with its clock set back; only robots that it does not receive know its term."""
    fleet = SignedFleet(TEAM, seed=1).after(3.0)
    for name in ("leader", "r0", "r1"):
        fleet.kill(name)
    fleet.run(6.0)
    fleet.nodes["leader"].clock_error = -3600.0
    for name in ("leader", "r0", "r1"):
        fleet.restart(name)
    fleet.run(3.0)
    assert len(terms(fleet)) == 2
    fleet.nodes["leader"].clock_error = 0.0
    fleet.run(4.0)
    assert terms(fleet) == {fleet.leader.term}
    assert fleet.states == {AgentState.RUN}


def test_unsigned_leader_leaves_robots_with_certificates_at_rest() -> None:
    """The robots have certificates, the leader has none."""
    fleet = SignedFleet(TEAM, seed=1, unsigned=frozenset({"leader"})).after(2.0)
    for name in ("r0", "r1"):
        assert fleet.agents[name].decision.state is AgentState.HOLD
        assert str(fleet.agents[name].decision.reason) == "order not signed by leader: it has no signature"
        assert fleet.last_command(name) == (0.0, 0.0)


@pytest.mark.slow
def test_signed_fleet_forms_after_leader_certificate_is_renewed() -> None:
    """The leader restarts with a new key; robots receive its certificate with the positions."""
    fleet = SignedFleet(TEAM, seed=3).after(4.0)
    keys = {fleet.signers["leader"].certificate}
    fleet.kill("leader")
    fleet.run(1.5)
    assert fleet.states == {AgentState.HOLD}
    fleet.restart("leader")
    keys.add(fleet.signers["leader"].certificate)
    assert len(keys) == 2
    fleet.run(2.0)
    assert fleet.states == {AgentState.RUN}
    fleet.run(8.0)
    assert fleet.error() < 0.05
    assert not fleet.leader.forgers(fleet.now)
    assert not any(agent.orders.forgers(fleet.moment) for agent in fleet.agents.values())


def test_restarted_robot_receives_certificate_and_runs() -> None:
    fleet = SignedFleet(TEAM, seed=4).after(3.0)
    fleet.kill("r4")
    fleet.run(1.0)
    fleet.restart("r4")
    fleet.run(2.5)
    assert fleet.agents["r4"].decision.state is AgentState.RUN


def test_signed_attachments_stay_below_900_bytes() -> None:
    """A position must fit into one datagram: 1150 bytes on a link that may drop."""
    what = Order(
        term=2**63 - 1, beat=10_000_000, mode="hold", shape="line", rotation=1.2345678901234567,
        scale=1.2345678901234567, base_mode="hold", holding=True, route="0123456789abcdef",
        time=12345.678901234,
        slots=Slots(
            mix={"line": 0.12345678901234567, "wedge": 0.8765432109876543}, rotation=-1.2345678901234567,
            scale=1.2345678901234567,
        ),
    )  # fmt: skip
    attachment = PositionAttachment(
        publisher_id="0123456789abcdef", count=10_000_000, unavailable=True,
        voted_term=2**63 - 1, last_ballot=2**40,
    )  # fmt: skip
    ordered = {"order": what, **signed(TEAM, what, signer("leader"))}
    assert len(json_message.encode(attachment.model_copy(update=ordered))) < 800
    certificate = signer("a-leader-with-a-name-of-some-length").certificate
    carried = {"term": 2**63 - 1, "certificate": certificate}
    assert len(json_message.encode(attachment.model_copy(update=carried))) < 900
