"""Attacks on a driving team: each is refused and counted, and changes no command."""

from __future__ import annotations

import json
import signal
import time
from collections.abc import Iterator

import psutil
import pytest

from formation.topics import POSITION
from tests.field.assault import LASTS, attack, link, wait_for_refusals, without_effect
from tests.field.team import VICTIM, Band, Team, driving
from tests.support.namespaces import Running, until

pytestmark = [pytest.mark.namespaces, pytest.mark.processes]


@pytest.fixture(scope="module")
def team(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Team]:
    with driving(tmp_path_factory.mktemp("team")) as team:
        yield team


def test_victim_refuses_nothing_without_attack(team: Team) -> None:
    with without_effect(team):
        time.sleep(LASTS)
    assert team.refused() == {}


def test_monitor_and_operator_are_never_refused(team: Team) -> None:
    """A monitor subscribes at the desk, and an operator requests a release."""
    before = team.refused()
    flags = ("-c", str(team.desk.file("monitor")), "--no-record", "--snapshots")
    order = team.formation("order", "release", "-c", str(team.desk.file("operator")), "--json")
    with without_effect(team):
        monitor = team.desk_computer.start(*team.formation("monitor", *flags))
        monitor.event("ready")
        until(lambda: receives(monitor), what="the monitor receives the victim's status")
        time.sleep(LASTS)
        answer = team.desk_computer.run(*order)
        assert monitor.stop() == 0
    result = json.loads(answer.stdout.splitlines()[-1])
    assert {one["robot"] for one in result["acknowledged"]} == {"leader", "robot1", VICTIM}
    received = monitor.event("summary")["received"]
    assert all(received[f"{VICTIM}/{topic}"] > 0 for topic in ("odom", "cmd_vel", "position", "status"))
    assert team.refused() == before


def receives(monitor: Running) -> bool:
    """Whether a monitor has received the victim's status, to which it subscribes last."""
    shown = monitor.events("snapshot")
    return bool(shown) and shown[-1]["robots"][VICTIM]["state"] == "run"


@pytest.mark.parametrize("key", ["leader/position", "robot1/position", "robot2/position"])
def test_robot_cannot_publish_as_another_robot(team: Team, key: str) -> None:
    before = team.refused()
    with without_effect(team):
        sent = attack(team, "put", link=link(team, "robot3"), keys=[key], seconds=LASTS)
        wait_for_refusals(team, f"put {key} by robot3", before, by=sent)
    assert sent > 50
    assert team.refused()[f"put {key} by robot3"] - before.get(f"put {key} by robot3", 0) == sent


def test_neighbour_cannot_publish_as_the_leader(team: Team) -> None:
    before = team.refused()
    with without_effect(team):
        sent = attack(team, "put", link=link(team, "robot1"), keys=["leader/position"], seconds=LASTS)
        wait_for_refusals(team, "put leader/position by robot1", before, by=sent)


@pytest.mark.parametrize("sender", ["robot1", "robot3", "monitor", "operator"])
def test_wildcard_messages_are_refused(team: Team, sender: str) -> None:
    before = team.refused()
    keys = ["*/position", "robot1/*", "**", "leader/**"]
    with without_effect(team):
        attack(team, "put", link=link(team, sender), keys=keys, seconds=1.0)
        for key in keys:
            wait_for_refusals(team, f"put {key} by {sender}", before, by=40)


@pytest.mark.parametrize("sender", ["robot1", "robot3", "monitor"])
def test_orders_by_others_than_operators_are_refused(team: Team, sender: str) -> None:
    before = team.refused()
    keys = ["robot2/order", "*/order"]
    with without_effect(team):
        assert attack(team, "query", link=link(team, sender), keys=keys) == 0
        for key in keys:
            wait_for_refusals(team, f"query {key} by {sender}", before)


def test_robot_cannot_read_zenoh_admin_space(team: Team) -> None:
    """The admin space lists links and subscriptions of processes."""
    before = team.refused()
    keys = ["@/*/peer", "@/*/peer/**"]
    with without_effect(team):
        assert attack(team, "query", link=link(team, "robot3"), keys=keys) == 0
        for key in keys:
            wait_for_refusals(team, f"query {key} by robot3", before)


def test_forged_liveliness_tokens_are_refused(team: Team) -> None:
    before = team.refused()
    keys = ["robot1/alive", "leader/position"]
    with without_effect(team):
        attack(team, "declare", link=link(team, "robot3"), keys=keys, seconds=1.0)
        for key in keys:
            wait_for_refusals(team, f"liveliness token {key} by robot3", before)


def test_replayed_messages_are_dropped(team: Team) -> None:
    """Messages of a neighbour, replayed with its own key from another computer."""
    key = POSITION.key("robot1")
    result = attack(team, "listen", link=link(team, "monitor", "robot1"), key=key, number=40)
    dropped = team.dropped().get(key, (0, ""))[0]
    with without_effect(team):
        attack(team, "replay", link=link(team, "robot1"), key=key, samples=result)
        until(
            lambda: team.dropped().get(key, (0, ""))[0] >= dropped + len(result), what="replays are counted"
        )
    assert "repeated" in team.dropped()[key][1]


def test_second_agent_of_a_robot_is_ignored(team: Team) -> None:
    """An agent with robot1's key on another computer, with a simulated robot of its own."""
    key = POSITION.key("robot1")
    dropped = team.dropped().get(key, (0, ""))[0]
    ends = [team.desk.endpoint("leader"), team.desk.endpoint(VICTIM)]
    flags = [
        "--cfg",
        'listen/endpoints:["tls/10.77.0.4:7460"]',
        "--cfg",
        f"connect/endpoints:{ends}".replace("'", '"'),
    ]
    with without_effect(team):
        body = team.attacker.start(*team.formation("robot", "--robot", "robot1"))
        second = team.attacker.start(
            *team.formation("agent", "--robot", "robot1", "-c", str(team.desk.file("robot1")), *flags)
        )
        second.event("ready")
        until(
            lambda: team.dropped().get(key, (0, ""))[0] >= dropped + 40,
            what="the second publisher is counted",
        )
        assert team.status()["contested"] == "robot1"
        assert second.stop() == 0
        assert body.stop() == 0
    assert "second publisher" in team.dropped()[key][1]


def test_flood_of_refused_messages_is_harmless(team: Team) -> None:
    before = team.refused()
    victim = psutil.Process(team.running[VICTIM].pid)
    memory = victim.memory_info().rss
    with without_effect(team):
        sent = attack(
            team, "put", link=link(team, "robot3"), keys=["leader/position"], seconds=LASTS, rate=1000.0
        )
        wait_for_refusals(team, "put leader/position by robot3", before, by=sent)
    assert sent > 1000
    assert victim.memory_info().rss - memory < 8 * 2**20


def test_stolen_key_of_absent_robot_impersonates_it(team: Team) -> None:
    """A known limit; it shows that the tests above would detect an effect."""
    until(team.settled, what="settled before the attack")
    band = Band.of(team.commands()[-40:])
    team.running["robot1"].signal(signal.SIGKILL)
    start = time.monotonic()
    attack(team, "put", link=link(team, "robot1"), keys=["robot1/position"], seconds=LASTS)
    until(
        lambda: [command for command in team.commands(since=start) if not band.holds(command)],
        what="a command that is not as before",
    )


def test_summary_contains_refusals_and_drops(team: Team) -> None:
    kind = "put leader/position by robot3"
    before = team.refused()
    sent = attack(team, "put", link=link(team, "robot3"), keys=["leader/position"], seconds=0.5)
    wait_for_refusals(team, kind, before, by=sent)
    counted, dropped = team.refused(), team.dropped()
    agent = team.running[VICTIM]
    assert agent.stop() == 0
    summary = agent.event("summary")
    assert summary["refused"][kind] >= sent
    assert all(summary["refused"][one] >= number for one, number in counted.items())
    assert all(summary["dropped"][key] >= number for key, (number, _) in dropped.items())
