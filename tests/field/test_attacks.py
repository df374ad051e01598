"""Attacks on a driving team, with valid certificates and without: each is refused and changes no command."""

from __future__ import annotations

import json
import signal
import sys
import time
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import psutil
import pytest

from formation.deploy.fleet import access, certificates
from formation.topics import POSITION
from tests.field.assault import LASTS, link, usual, wait_for_refusals, without_effect
from tests.field.team import VICTIM, Team, attack, driving, issued, mission
from tests.support.namespaces import Running, until

pytestmark = [pytest.mark.namespaces, pytest.mark.processes]
FIREWALL = Path(access.__file__).with_name("firewall.nft")


@pytest.fixture(scope="module")
def team(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Team]:
    with driving(tmp_path_factory.mktemp("team")) as team:
        assert team.refused() == {}
        yield team


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


@pytest.mark.parametrize(
    ("sender", "names"), [("robot3", ["leader", "robot1", "robot2"]), ("robot1", ["leader"])]
)
def test_robot_cannot_publish_as_another_robot(team: Team, sender: str, names: list[str]) -> None:
    before = team.refused()
    keys = [POSITION.key(name) for name in names]
    kinds = [f"put {key} by {sender}" for key in keys]
    with without_effect(team):
        sent = team.attack("put", link=link(team, sender), keys=keys, seconds=LASTS) // len(keys)
        for kind in kinds:
            wait_for_refusals(team, kind, before, by=sent)
    assert sent > 50
    assert [team.refused()[kind] - before.get(kind, 0) for kind in kinds] == [sent for _ in kinds]


@pytest.mark.parametrize("sender", ["robot1", "robot3", "monitor", "operator"])
def test_wildcard_messages_are_refused(team: Team, sender: str) -> None:
    before = team.refused()
    keys = ["*/position", "robot1/*", "**", "leader/**"]
    with without_effect(team):
        team.attack("put", link=link(team, sender), keys=keys, seconds=1.0)
        for key in keys:
            wait_for_refusals(team, f"put {key} by {sender}", before, by=40)


@pytest.mark.parametrize(
    ("sender", "keys"),
    [
        ("robot1", ["robot2/order", "*/order"]),
        ("robot3", ["robot2/order", "*/order", "@/*/peer", "@/*/peer/**"]),
        ("monitor", ["robot2/order", "*/order"]),
    ],
)
def test_queries_by_others_than_operators_are_refused(team: Team, sender: str, keys: list[str]) -> None:
    """Orders, and Zenoh's admin space, which lists links and subscriptions of processes."""
    before = team.refused()
    with without_effect(team):
        assert team.attack("query", link=link(team, sender), keys=keys) == 0
        for key in keys:
            wait_for_refusals(team, f"query {key} by {sender}", before)


def test_forged_liveliness_tokens_are_refused(team: Team) -> None:
    before = team.refused()
    keys = ["robot1/alive", "leader/position"]
    with without_effect(team):
        team.attack("declare", link=link(team, "robot3"), keys=keys, seconds=1.0)
        for key in keys:
            wait_for_refusals(team, f"liveliness token {key} by robot3", before)


def test_replayed_messages_are_dropped(team: Team) -> None:
    """Messages of a neighbour, replayed with its own key from another computer."""
    key = POSITION.key("robot1")
    result = team.attack("listen", link=link(team, "monitor", "robot1"), key=key, number=40)
    dropped = team.dropped().get(key, (0, ""))[0]
    with without_effect(team):
        team.attack("replay", link=link(team, "robot1"), key=key, samples=result)
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
        sent = team.attack(
            "put", link=link(team, "robot3"), keys=["leader/position"], seconds=LASTS, rate=1000.0
        )
        wait_for_refusals(team, "put leader/position by robot3", before, by=sent)
    assert sent > 1000
    assert victim.memory_info().rss - memory < 8 * 2**20


def strange(folder: Path, name: str) -> Path:
    """Folder with a certificate of `name` by a foreign authority with the name of ours."""
    certificates.create(mission(), folder, days=1.0, authority_days=1.0, now=datetime.now(UTC))
    return folder / name


def test_certificate_of_a_foreign_authority_is_refused(team: Team, tmp_path: Path) -> None:
    before = team.refused()
    how = link(team, "robot1", identity=strange(tmp_path / "rogue", "robot1"))
    with without_effect(team):
        assert team.attack("dial", link=how, times=10) == 0
        wait_for_refusals(team, "certificate: bad signature", before, by=10)


@pytest.mark.parametrize(
    ("begins", "kind"),
    [(-timedelta(days=1), "certificate: expired"), (timedelta(days=1), "certificate: not valid yet")],
)
def test_certificate_outside_its_validity_is_refused(
    team: Team, tmp_path: Path, begins: timedelta, kind: str
) -> None:
    before = team.refused()
    how = link(team, "robot1", identity=issued(team.desk, tmp_path / "id", "robot1", begins=begins))
    with without_effect(team):
        assert team.attack("dial", link=how, times=5) == 0
        wait_for_refusals(team, kind, before, by=5)


def test_peer_without_tls_is_refused(team: Team) -> None:
    before = team.refused()
    address, port = team.computers[VICTIM].address, 7460
    plain = link(team, "robot1")
    plain["victims"] = [team.desk.endpoint(VICTIM).replace("tls/", "tcp/")]
    with without_effect(team):
        assert team.attack("dial", link=plain, times=5) == 0
        team.attack("talk", address=address, port=port, words=b"GET / HTTP/1.0\r\n\r\n".hex())
        wait_for_refusals(team, "not TLS", before, by=6)


def test_robot_router_is_reachable_only_on_loopback(team: Team) -> None:
    """The robot's ROS 2 router has neither certificates nor access rules."""
    reach = f"import socket; socket.create_connection(('{team.computers[VICTIM].address}', 7447), 2.0)"
    done = team.attacker.run(sys.executable, "-c", reach)
    assert "ConnectionRefusedError" in done.stderr


def test_operator_order_is_acknowledged_during_connection_flood(team: Team) -> None:
    """Zenoh pauses 0.1 s after each link that it refused; the firewall limits how often that happens."""
    team.computers[VICTIM].nft(FIREWALL.read_text(encoding="utf-8"))
    address = team.computers[VICTIM].address
    order = team.formation("order", "release", "-c", str(team.desk.file("operator")), "--json")
    with without_effect(team):
        crowd = team.start_attacker()
        crowd.tell(attack("knock", address=address, port=7460), last=True)
        crowd.event("knocking")
        time.sleep(LASTS)
        answer = team.desk_computer.run(*order)
        assert not crowd.ended
        assert crowd.stop() == 0, crowd.errors
        assert crowd.event("done")["result"] > 0
    team.computers[VICTIM].nft("delete table inet formation")
    report = json.loads(answer.stdout.splitlines()[-1])
    assert VICTIM in {one["robot"] for one in report["acknowledged"]}, answer.stdout


def test_unfinished_handshakes_disturb_no_robot(team: Team) -> None:
    """When they close, Zenoh pauses 0.1 s for each; after that it accepts links again.

    They are more than the links that Zenoh accepts at a time, 100.
    """
    address = team.computers[VICTIM].address
    with without_effect(team):
        assert team.attack("crowd", address=address, port=7460, number=120, seconds=LASTS) == 120
    until(lambda: team.attack("dial", link=link(team, "robot3"), times=1) == 1, 60.0, "new links")


def test_stolen_key_of_absent_robot_impersonates_it(team: Team) -> None:
    """A known limit; it shows that the tests above would detect an effect."""
    band = usual(team)
    team.running["robot1"].signal(signal.SIGKILL)
    start = time.monotonic()
    team.attack("put", link=link(team, "robot1"), keys=["robot1/position"], seconds=LASTS)
    until(
        lambda: [command for command in team.commands(since=start) if not band.holds(command)],
        what="a command that is not as before",
    )


def test_certificate_expiring_during_link_holds_robot(team: Team) -> None:
    """The leader is killed, and started again with one that expires soon."""
    team.running["leader"].signal(signal.SIGKILL)
    until(lambda: team.status()["state"] == "hold", what="the victim holds without a leader")
    issued(team.desk, team.desk.folder / "leader", "leader", seconds=15.0)
    team.start_process("leader")
    until(lambda: team.status()["state"] == "run", what="the victim runs")
    kind = "certificate: expired during the link"
    until(lambda: kind in team.refused(), 60.0, f"{kind!r} in the status")
    until(lambda: team.status()["state"] == "hold", what="the victim holds")
    again = f"dialling {team.desk.endpoint('leader')}: certificate: expired"
    until(lambda: again in team.refused(), what=f"{again!r} in the status")
    held = time.monotonic()
    until(lambda: len(team.commands(since=held)) > 20, what="commands while it holds")
    after = team.commands(since=held)
    assert {(command.speed, command.turn_rate) for command in after} == {(0.0, 0.0)}
    assert team.status()["state"] == "hold"


def test_summary_contains_refusals_and_drops(team: Team) -> None:
    kind = "put leader/position by robot3"
    before = team.refused()
    sent = team.attack("put", link=link(team, "robot3"), keys=["leader/position"], seconds=0.5)
    wait_for_refusals(team, kind, before, by=sent)
    counted, dropped = team.refused(), team.dropped()
    agent = team.running[VICTIM]
    assert agent.stop() == 0
    summary = agent.event("summary")
    assert summary["refused"][kind] >= sent
    assert all(summary["refused"][one] >= number for one, number in counted.items())
    assert all(summary["dropped"][key] >= number for key, (number, _) in dropped.items())
