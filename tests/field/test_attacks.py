"""Attacks on a team that drives: each is refused, each is counted, and no command is any different for it."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import psutil
import pytest

from deploy.field import access, certificates
from formation.topics import POSITION
from tests.field.namespaces import until
from tests.field.team import VICTIM, Band, Team, driving, issued, longest_gap, mission

pytestmark = [pytest.mark.namespaces, pytest.mark.processes]
FIREWALL = Path(access.__file__).with_name("firewall.nft")
BEFORE = 2.0
"""So long before an attack commands are what they are without one [s]."""
LASTS = 2.0
"""How long an attack goes on [s]."""
SILENCE = 0.3
"""The guard would stop the robot after that; nobody's attack may keep commands away so long [s]."""


@pytest.fixture(scope="module")
def team(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Team]:
    with driving(tmp_path_factory.mktemp("team")) as team:
        yield team


def link(team: Team, name: str, victim: str = VICTIM, identity: Path | None = None) -> dict[str, Any]:
    """How the attacker links with the victim: with the key of `name`, or another one."""
    folder = team.desk.folder / name
    return {
        "identity": str(identity or folder),
        "trusted": str(folder / "ca.pem"),
        "victims": [team.desk.endpoint(victim)],
        "team": mission().team,
    }


@contextmanager
def without_effect(team: Team) -> Iterator[None]:
    """What happens in here must not show in any command, nor in the state of the victim."""
    until(team.settled, what="settled before the attack")
    time.sleep(BEFORE)
    start = time.monotonic()
    usual = team.commands(since=start - BEFORE)
    band = Band.of(usual)
    yield
    end = time.monotonic()
    until(lambda: team.commands(since=end), what="a command after the attack")
    during = team.commands(since=start)
    assert len(during) > 15 * (end - start), "commands were kept away"
    assert longest_gap(during) < SILENCE
    assert [command for command in during if not band.holds(command)] == [], band
    assert team.states(since=start) <= {"run"}


def attack(team: Team, kind: str, **how: Any) -> Any:
    """Attack, to the end; what the attacker knows of its success."""
    running = team.attack(kind, **how)
    done = running.event("done")["result"]
    assert running.wait() == 0, running.errors
    return done


def rises(team: Team, kind: str, before: dict[str, int], by: int = 1) -> None:
    """The victim's status soon says that so many more were refused."""
    until(
        lambda: team.refused().get(kind, 0) - before.get(kind, 0) >= by,
        what=f"{by} times {kind!r}; there is {team.refused()}",
    )


def test_the_team_is_at_peace_without_an_attack(team: Team) -> None:
    with without_effect(team):
        time.sleep(LASTS)
    assert team.refused() == {}


@pytest.mark.parametrize("key", ["leader/position", "robot1/position", "robot2/position"])
def test_a_valid_certificate_does_not_speak_for_another_robot(team: Team, key: str) -> None:
    before = team.refused()
    with without_effect(team):
        sent = attack(team, "put", link=link(team, "robot3"), keys=[key], seconds=LASTS)
        rises(team, f"put {key} by robot3", before, by=sent)
    assert sent > 50
    assert team.refused()[f"put {key} by robot3"] - before.get(f"put {key} by robot3", 0) == sent


def test_a_neighbours_certificate_does_not_speak_for_the_leader(team: Team) -> None:
    before = team.refused()
    with without_effect(team):
        sent = attack(team, "put", link=link(team, "robot1"), keys=["leader/position"], seconds=LASTS)
        rises(team, "put leader/position by robot1", before, by=sent)


@pytest.mark.parametrize("who", ["robot1", "robot3", "monitor", "operator"])
def test_wildcards_reach_nothing(team: Team, who: str) -> None:
    before = team.refused()
    keys = ["*/position", "robot1/*", "**", "leader/**"]
    with without_effect(team):
        attack(team, "put", link=link(team, who), keys=keys, seconds=1.0)
        for key in keys:
            rises(team, f"put {key} by {who}", before, by=40)


@pytest.mark.parametrize("who", ["robot1", "robot3", "monitor"])
def test_only_an_operator_gives_orders(team: Team, who: str) -> None:
    before = team.refused()
    keys = ["robot2/order", "*/order"]
    with without_effect(team):
        assert attack(team, "query", link=link(team, who), keys=keys) == 0
        for key in keys:
            rises(team, f"query {key} by {who}", before)


def test_what_a_robot_is_linked_with_is_not_told_to_strangers(team: Team) -> None:
    """Zenoh's admin space, which says who is linked with whom and listens to what."""
    before = team.refused()
    keys = ["@/*/peer", "@/*/peer/**"]
    with without_effect(team):
        assert attack(team, "query", link=link(team, "robot3"), keys=keys) == 0
        for key in keys:
            rises(team, f"query {key} by robot3", before)


def test_the_robots_own_side_is_not_there_for_others(team: Team) -> None:
    """Its ROS 2 router has neither certificates nor rules, but listens on loopback only."""
    reach = f"import socket; socket.create_connection(('{team.computers[VICTIM].address}', 7447), 2.0)"
    done = team.attacker.run(sys.executable, "-c", reach)
    assert "ConnectionRefusedError" in done.stderr


def test_tokens_that_are_forged_are_not_taken(team: Team) -> None:
    before = team.refused()
    keys = ["robot1/alive", "leader/position"]
    with without_effect(team):
        attack(team, "declare", link=link(team, "robot3"), keys=keys, seconds=1.0)
        for key in keys:
            rises(team, f"liveliness token {key} by robot3", before)


def strange(folder: Path, name: str) -> Path:
    """The folder of a certificate that says `name`, by an authority that calls itself as ours does."""
    certificates.create(mission(), folder, days=1.0, authority_days=1.0, now=datetime.now(UTC))
    return folder / name


def test_an_authority_that_only_has_our_name_is_none(team: Team, tmp_path: Path) -> None:
    before = team.refused()
    how = link(team, "robot1", identity=strange(tmp_path / "rogue", "robot1"))
    with without_effect(team):
        assert attack(team, "dial", link=how, times=10) == 0
        rises(team, "certificate: bad signature", before, by=10)


@pytest.mark.parametrize(
    ("begins", "kind"),
    [(-timedelta(days=1), "certificate: expired"), (timedelta(days=1), "certificate: not valid yet")],
)
def test_a_certificate_is_good_in_its_time_only(
    team: Team, tmp_path: Path, begins: timedelta, kind: str
) -> None:
    before = team.refused()
    how = link(team, "robot1", identity=issued(team.desk, tmp_path / "id", "robot1", begins=begins))
    with without_effect(team):
        assert attack(team, "dial", link=how, times=5) == 0
        rises(team, kind, before, by=5)


def test_who_proves_nothing_is_not_listened_to(team: Team) -> None:
    before = team.refused()
    address, port = team.computers[VICTIM].address, 7460
    plain = link(team, "robot1")
    plain["victims"] = [team.desk.endpoint(VICTIM).replace("tls/", "tcp/")]
    with without_effect(team):
        assert attack(team, "dial", link=plain, times=5) == 0
        attack(team, "talk", address=address, port=port, words=b"GET / HTTP/1.0\r\n\r\n".hex())
        rises(team, "not TLS", before, by=6)


def test_what_was_said_before_is_not_believed_again(team: Team) -> None:
    """With the robot's own key: the tape of a neighbour, played back from elsewhere."""
    said = attack(team, "listen", link=link(team, "monitor", "robot1"), key="robot1/position", seconds=LASTS)
    assert len(said) > 15 * LASTS
    key = POSITION.key("robot1")
    dropped = team.dropped().get(key, (0, ""))[0]
    with without_effect(team):
        attack(team, "replay", link=link(team, "robot1"), key=key, samples=said)
        until(lambda: team.dropped().get(key, (0, ""))[0] >= dropped + len(said), what="replays are counted")
    assert "said before" in team.dropped()[key][1]


def test_a_second_agent_for_the_same_robot_has_no_say(team: Team) -> None:
    """With the robot's own key, on another host, beside a robot of its own: the first one's word counts."""
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
        until(lambda: team.dropped().get(key, (0, ""))[0] >= dropped + 40, what="the second voice is counted")
        assert team.status()["second voice robot1"] == "two agents speak for it"
        assert second.stop() == 0
        assert body.stop() == 0
    assert "second voice" in team.dropped()[key][1]


def test_the_operator_is_heard_beside_a_crowd_that_comes_again_and_again(team: Team) -> None:
    """Zenoh rests 0.1 s after each link that it did not take, so strangers must not come too often."""
    team.computers[VICTIM].nft(FIREWALL.read_text(encoding="utf-8"))
    address = team.computers[VICTIM].address
    order = team.formation("order", "release", "-c", str(team.desk.file("operator")), "--json")
    with without_effect(team):
        crowd = team.attack("knock", address=address, port=7460, seconds=3 * LASTS)
        time.sleep(LASTS)
        answer = team.desk_computer.run(*order)
        assert not crowd.ended
        assert crowd.event("done")["result"] > 0
    team.computers[VICTIM].nft("delete table inet formation")
    assert json.loads(answer.stdout.splitlines()[-1])["robots"][VICTIM]["ok"], answer.stdout


def test_a_flood_of_refused_messages_disturbs_nobody_and_fills_no_memory(team: Team) -> None:
    before = team.refused()
    victim = psutil.Process(team.running[VICTIM].pid)
    memory = victim.memory_info().rss
    with without_effect(team):
        sent = attack(
            team, "put", link=link(team, "robot3"), keys=["leader/position"], seconds=LASTS, rate=1000.0
        )
        rises(team, "put leader/position by robot3", before, by=sent)
    assert sent > 1000
    assert victim.memory_info().rss - memory < 8 * 2**20


def test_a_crowd_that_never_finishes_its_hellos_disturbs_nobody(team: Team) -> None:
    """When they go, Zenoh rests 0.1 s for each and lets nobody new in; then it does again."""
    address = team.computers[VICTIM].address
    with without_effect(team):
        assert attack(team, "crowd", address=address, port=7460, number=200, seconds=LASTS) == 200
    until(lambda: attack(team, "dial", link=link(team, "robot3"), times=1) == 1, 60.0, "new links")


def test_all_of_it_stands_in_the_summary_at_the_end(team: Team) -> None:
    kind = "put leader/position by robot3"
    before = team.refused()
    sent = attack(team, "put", link=link(team, "robot3"), keys=["leader/position"], seconds=0.5)
    rises(team, kind, before, by=sent)
    counted, dropped = team.refused(), team.dropped()
    agent = team.running[VICTIM]
    assert agent.stop() == 0
    summary = agent.event("summary")
    assert summary["refused"][kind] >= sent
    assert all(summary["refused"][one] >= number for one, number in counted.items())
    assert all(summary["dropped"][key] >= number for key, (number, _) in dropped.items())


def test_a_certificate_that_runs_out_on_the_way_ends_the_link_and_the_robot_holds(tmp_path: Path) -> None:
    with driving(tmp_path, expires={"leader": 25.0}) as team:
        kind = "certificate: expired during the link"
        until(lambda: kind in team.refused(), 60.0, f"{kind!r} in the status")
        until(lambda: team.status()["state"] == "hold", what="the victim holds")
        again = f"dialling {team.desk.endpoint('leader')}: certificate: expired"
        until(lambda: again in team.refused(), what=f"{again!r} in the status")
        held = time.monotonic()
        time.sleep(2.0)
        after = team.commands(since=held)
        assert len(after) > 20
        assert {(command.speed, command.turn_rate) for command in after} == {(0.0, 0.0)}
        assert team.status()["state"] == "hold"
