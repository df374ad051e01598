"""Forged orders, relayed with a stolen robot key over real links: they are refused.

`tests/unit/formation/test_verifying.py` tries every forgery.
"""

from __future__ import annotations

import json
import secrets
import signal
import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from typing import Any, NamedTuple

import pytest

from formation.deploy.fleet import authority, certificates
from formation.protocol import json_message
from formation.protocol.attachment import PositionAttachment
from formation.topics import POSITION
from tests.field.assault import link
from tests.field.team import VICTIM, Team, driving, mission
from tests.support.namespaces import until

pytestmark = [pytest.mark.namespaces, pytest.mark.processes]
THIEF = "robot1"
KEY = POSITION.key(THIEF)
NUMBER = 30
"""Messages of one attack."""


class Held(NamedTuple):
    """A team in hold, and messages of robot1 from before its key was stolen."""

    team: Team
    ran: list[PositionAttachment]
    """Messages with an order to run, newest last."""


@pytest.fixture(scope="module")
def held(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Held]:
    with driving(tmp_path_factory.mktemp("team")) as team:
        tape = team.attack("listen", link=link(team, "monitor", THIEF), key=KEY, number=NUMBER)
        decoded = [
            json_message.decode(PositionAttachment, bytes.fromhex(attachment)) for _, attachment in tape
        ]
        answer = team.desk_computer.run(
            *team.formation("order", "hold", "-c", str(team.desk.file("operator")), "--json")
        )
        result = json.loads(answer.stdout.splitlines()[-1])
        assert result["refused"] == [], result
        assert {one["robot"] for one in result["acknowledged"]} >= {"leader", VICTIM}
        until(lambda: team.status().get("state") == "hold", what="the victim holds")
        team.running[THIEF].signal(signal.SIGKILL)
        time.sleep(1.0)
        yield Held(team, [one for one in decoded if one.order is not None])


def changed(held: Held, **changes: Any) -> dict[str, Any]:
    """The newest order to run with changes, and its old signature."""
    newest = held.ran[-1]
    assert newest.order is not None
    what = newest.order.model_copy(update={"beat": newest.order.beat + 100_000, **changes})
    return {"signed": json_message.encode(what).decode(), "signature": newest.signature}


def rogue_certificate(held: Held) -> dict[str, Any]:
    """A certificate with the leader's name by a foreign authority of the same name."""
    ours = certificates.read_authority(held.team.desk.folder)
    rogue = authority.new_authority(ours.name, 1.0, datetime.now(UTC))
    text = "".join(
        authority.issue(rogue, "leader", None, 1.0, datetime.now(UTC))
        .certificate_pem.decode()
        .splitlines()[1:-1]
    )
    return {"certificate": text.replace("+", "-").replace("/", "_").rstrip("=")}


FORGERIES: dict[str, tuple[Callable[[Held], dict[str, Any]], tuple[str, ...]]] = {
    "unsigned": (
        lambda held: {"order": json.loads(changed(held)["signed"])},
        ("order not signed by leader: it has no signature",),
    ),
    "stop": (
        lambda held: changed(held, mode="stop"),
        ("order not signed by leader: wrong signature", "order not signed by leader: after 3 wrong"),
    ),
    "rogue certificate": (
        rogue_certificate,
        (
            "order not signed by a candidate: certificate of 'leader' is not",
            "order not signed by a candidate",
        ),
    ),
}


def relayed(held: Held, fields: dict[str, Any]) -> None:
    """Publish positions of robot1 with `fields`, with rising counts and beats."""
    publisher_id = secrets.token_hex(8)
    attachments = []
    for count in range(NUMBER):
        decoded = PositionAttachment.model_validate(
            {"publisher_id": publisher_id, "count": count + 1, "mission": mission().tag, **fields}
        )
        if decoded.order is not None:
            risen = decoded.order.model_copy(update={"beat": decoded.order.beat + count})
            decoded = decoded.model_copy(update={"order": risen})
        attachments.append(json_message.encode(decoded).hex())
    held.team.attack("relay", link=link(held.team, THIEF), key=KEY, attachments=attachments)


@pytest.mark.parametrize("kind", list(FORGERIES))
def test_forged_order_is_refused_and_named(held: Held, kind: str) -> None:
    team, (forgery, whys) = held.team, FORGERIES[kind]
    start = time.monotonic()
    relayed(held, forgery(held))
    until(
        lambda: any(team.status().get(f"forged.{THIEF}", "").startswith(why) for why in whys),
        what=f"one of {whys}, not {team.status()}",
    )
    assert team.states(since=start) == {"hold"}
    assert all((one.speed, one.turn_rate) == (0.0, 0.0) for one in team.commands(since=start))
    time.sleep(0.2)  # until another publisher of robot1 is accepted


def test_replayed_orders_change_nothing(held: Held) -> None:
    """Their signatures are right, but the leader has ordered hold since."""
    team, start, publisher_id = held.team, time.monotonic(), secrets.token_hex(8)
    attachments = []
    for count, one in enumerate(held.ran):
        decoded = one.model_copy(update={"publisher_id": publisher_id, "count": count + 1})
        attachments.append(json_message.encode(decoded).hex())
    team.attack("relay", link=link(team, THIEF), key=KEY, attachments=attachments)
    time.sleep(1.0)
    assert team.states(since=start) == {"hold"}
    assert all((one.speed, one.turn_rate) == (0.0, 0.0) for one in team.commands(since=start))


def test_leader_reports_forgeries(held: Held) -> None:
    """The leader is linked with robot1 as well."""
    fields = {"order": json.loads(changed(held)["signed"])}
    decoded = PositionAttachment.model_validate(
        {"publisher_id": secrets.token_hex(8), "count": 1, "mission": mission().tag, **fields}
    )
    attachments = [json_message.encode(decoded).hex()]
    held.team.attack("relay", link=link(held.team, THIEF, "leader"), key=KEY, attachments=attachments)
    alarm = "ALARM: robot1 relays a forged order: order not signed by leader: it has no signature"
    until(lambda: alarm in held.team.running["leader"].errors, what=held.team.running["leader"].errors[-500:])
