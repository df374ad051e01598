"""Access control: the table of permitted messages, and the Zenoh rules made of it."""

from __future__ import annotations

import fnmatch
import itertools
import json
from collections.abc import Iterator
from functools import cache
from pathlib import Path, PurePath
from typing import Any

import pytest

from formation.deploy.fleet import access
from formation.deploy.fleet.access import MONITOR, OPERATOR, hosts
from formation.deploy.refusal import Refusal
from formation.mission.file import shipped
from formation.mission.model import Mission
from formation.topics import BALLOT, ORDER, POSITION, ROUTE, STATUS, TABLE
from formation.transport.wiring import members, partners
from tests.field.missions import in_the_field, on_a_wireless_network
from tests.unit.formation import scenarios

MISSIONS = {
    f"{name}{'-' + team if team else ''}": in_the_field(name, on_a_wireless_network, team)
    for name in shipped()
    for team in (None, "reds")
    if team is None or name not in {"two_chains", "patrol"}  # which are large
}
MESSAGES = (
    "put", "delete", "declare_subscriber", "query", "declare_queryable", "reply",
    "liveliness_token", "liveliness_query", "declare_liveliness_subscriber",
)  # fmt: skip
MISSIONS["avoiding"] = scenarios.clearing(MISSIONS["turtlebot3_pair"])
EVERY_MISSION = pytest.mark.parametrize("mission", MISSIONS.values(), ids=MISSIONS)


def allows(rules: dict[str, Any], peer: str, flow: str, message: str, key: str) -> bool:
    """Whether Zenoh permits a message by these rules, written a second time from its documentation."""
    assert rules["enabled"]
    assert rules["default_permission"] == "deny"
    by_id = {rule["id"]: rule for rule in rules["rules"]}
    subjects = [one["id"] for one in rules["subjects"] if peer in one["cert_common_names"]]
    verdict = False
    for policy in rules["policies"]:
        if not set(policy["subjects"]) & set(subjects):
            continue
        for rule in map(by_id.__getitem__, policy["rules"]):
            fits = flow in rule["flows"] and message in rule["messages"]
            if fits and any(includes(pattern, key) for pattern in rule["key_exprs"]):
                if rule["permission"] == "deny":
                    return False
                verdict = True
    return verdict


def includes(pattern: str, key: str) -> bool:
    """Whether `pattern` includes every key that `key` matches."""
    if pattern in ("**", key):
        return True
    words, others = pattern.split("/"), key.split("/")
    return len(words) == len(others) and all(
        fnmatch.fnmatchcase(other, word) and other != "**" for word, other in zip(words, others, strict=True)
    )


def attempts(mission: Mission) -> Iterator[tuple[str, str, str, str]]:
    """All attempts: receiver, name in the certificate, message and key, wildcards among the keys.

    Of the robots that are neither receiver nor sender, one is tried in keys.
    """
    processes = access.processes(mission)
    fleet = members(mission)
    for me, peer in itertools.product(processes, (*processes, "robot99", "", "ca")):
        third = next(name for name in mission.names if name not in {me, peer})
        # all candidates may publish the leader's position
        names = [name for name in dict.fromkeys((me, peer, third, mission.leader)) if name in fleet]
        patterns = [topic.pattern for topic in TABLE]
        keys = {
            pattern.format(robot=robot, other=other)
            for pattern in patterns
            for robot in (*names, "*")
            for other in names
        }
        if me != peer:
            for message, key in itertools.product(MESSAGES, sorted(keys | {"**", "*/*", f"{me}/**"})):
                yield me, peer, message, key


def wire(mission: Mission, key: str) -> str:
    return f"{mission.team}/{key}" if mission.team else key


def permitted(mission: Mission) -> frozenset[tuple[str, str, str, str]]:
    """All attempts that succeed."""
    return _permitted(next(name for name, one in MISSIONS.items() if one is mission))


@cache
def _permitted(name: str) -> frozenset[tuple[str, str, str, str]]:
    mission = MISSIONS[name]
    rules = {me: access.access_control(mission, me) for me in access.processes(mission)}
    return frozenset(
        (me, peer, message, key)
        for me, peer, message, key in attempts(mission)
        if allows(rules[me], peer, "ingress", message, wire(mission, key))
    )


@EVERY_MISSION
def test_rules_permit_exactly_the_messages_of_the_table(mission: Mission) -> None:
    result = {(word.receiver, word.sender, word.message, word.key) for word in access.permissions(mission)}
    allowed = permitted(mission)
    # attempts include every key of the table, except sensors that measure a robot that is not tried
    assert {word for word in result if "/relative/" not in word[3]} <= allowed
    for me, peer, message, key in allowed:
        assert any((me, peer, message) == word[:3] and includes(word[3], key) for word in result), (
            f"{peer} may {message} {key} to {me}"
        )


@EVERY_MISSION
def test_robots_publish_only_own_keys_and_only_operator_queries(mission: Mission) -> None:
    for me, peer, message, key in permitted(mission):
        robot, topic = key.split("/", 1)
        match message:
            case "put":
                assert peer in publishers(mission, key)
                assert me in {MONITOR, OPERATOR} or me in receivers(mission, peer, key)
            case "reply" | "declare_queryable":
                assert (robot, me) == (peer, OPERATOR)
                assert peer in members(mission)
            case "query":
                assert peer == OPERATOR
                assert topic == "order"
            case "declare_subscriber":
                assert me in publishers(mission, key)
                assert peer in {MONITOR, OPERATOR} or peer in receivers(mission, me, key)
            case _:
                pytest.fail(f"{message} is never allowed")


def publishers(mission: Mission, key: str) -> set[str]:
    """Processes that may publish on a key: its robot and, for the leader's position, all candidates."""
    return {key.split("/", 1)[0]} | set(mission.candidates if key == POSITION.key(mission.leader) else ())


def receivers(mission: Mission, publisher: str, key: str) -> set[str]:
    """Robots and standbys that may receive a key."""
    robot, topic = key.split("/", 1)
    candidates, followers = set(mission.candidates), set(mission.followers)
    match topic:
        case "position":
            receivers = {i for i in followers if robot in mission.received_by(i)}  # that measure or avoid it
            if robot == mission.leader:
                return receivers
            return receivers | {one for one in candidates if robot in partners(mission, one)}
        case "ballot" if mission.standbys and publisher in candidates:
            return followers | candidates
        case "route" if mission.standbys and publisher in candidates:
            return candidates
        case _:
            return set()


@EVERY_MISSION
def test_only_candidates_publish_ballots_and_routes(mission: Mission) -> None:
    cast = {(me, peer, key) for me, peer, message, key in permitted(mission) if message == "put"}
    receiving = {BALLOT: (*members(mission), MONITOR), ROUTE: (*mission.candidates, MONITOR)}
    for topic, receivers in receiving.items():
        received = {(me, peer) for me, peer, key in cast if key.endswith(f"/{topic.name}")}
        wanted = {(me, peer) for me in receivers for peer in mission.candidates if me != peer}
        assert received == (wanted if mission.standbys else set())


@EVERY_MISSION
def test_monitor_may_only_subscribe(mission: Mission) -> None:
    assert {message for _, peer, message, _ in permitted(mission) if peer == MONITOR} == {
        "declare_subscriber"
    }


@EVERY_MISSION
def test_keys_of_another_team_are_denied(mission: Mission) -> None:
    team = mission.model_copy(update={"team": "blues"})
    for me in access.processes(mission):
        rules = access.access_control(mission, me)
        for word in access.permissions(mission):
            assert not allows(rules, word.sender, "ingress", word.message, wire(team, word.key))


@EVERY_MISSION
def test_rules_of_sender_and_receiver_agree(mission: Mission) -> None:
    rules = {me: access.access_control(mission, me) for me in access.processes(mission)}
    for me, peer, message, key in attempts(mission):
        if peer in rules:
            goes = allows(rules[peer], me, "egress", message, wire(mission, key))
            assert goes == allows(rules[me], peer, "ingress", message, wire(mission, key))


@EVERY_MISSION
def test_rules_permit_every_message_that_mission_needs(mission: Mission) -> None:
    for me in members(mission):
        rules = access.access_control(mission, me)

        def received(peer: str, message: str, key: str, rules: dict[str, Any] = rules) -> bool:
            return allows(rules, peer, "ingress", message, wire(mission, key))

        for j in mission.robots[me].measurable if me in mission.robots else ():
            assert received(j, "put", POSITION.key(j))
        for other in mission.followers:
            if me in mission.robots[other].measurable:
                assert received(other, "declare_subscriber", POSITION.key(me))
            if me in mission.candidates and mission.standbys:
                assert received(other, "put", POSITION.key(other))
                assert received(other, "declare_subscriber", BALLOT.key(me))
                if mission.leader in mission.robots[other].measurable:
                    assert received(other, "declare_subscriber", POSITION.key(mission.leader))
        assert received(MONITOR, "declare_subscriber", STATUS.key(me))
        assert received(OPERATOR, "query", ORDER.key(me))
        assert received(OPERATOR, "query", ORDER.pattern.format(robot="*"))


@EVERY_MISSION
def test_links_are_those_of_graph_monitor_and_operator(mission: Mission) -> None:
    where = hosts(mission)
    dialled = {
        process: set(configured(mission, process)["connect"]["endpoints"])
        for process in access.processes(mission)
    }
    for me in members(mission):
        assert configured(mission, me)["listen"]["endpoints"] == [where[me].endpoint]
        for other in members(mission):
            if other == me:
                continue
            both = (where[other].endpoint in dialled[me]) + (where[me].endpoint in dialled[other])
            assert both == (other in partners(mission, me))
    for visitor in (MONITOR, OPERATOR):
        assert dialled[visitor] == {host.endpoint for host in where.values()}
        assert configured(mission, visitor)["listen"]["endpoints"] == []


def configured(mission: Mission, process: str) -> dict[str, Any]:
    return access.configuration(mission, process, PurePath("/opt/formation/current/certificates"))


def test_configuration_file_parses_and_names_the_mission() -> None:
    mission = MISSIONS["turtlebot3_pair-reds"]
    text = access.text(mission, "robot1", configured(mission, "robot1"))
    comment = [line for line in text.splitlines() if line.startswith("//")]
    assert "robot1 in the mission turtlebot3-pair" in comment[0]
    settings = json.loads("\n".join(line for line in text.splitlines() if not line.startswith("//")))
    assert settings == configured(mission, "robot1")
    link = settings["transport"]["link"]
    assert link["protocols"] == ["tls"]
    assert link["tls"]["connect_private_key"] == "/opt/formation/current/certificates/key.pem"
    assert all(
        link["tls"][key] for key in ("enable_mtls", "verify_name_on_connect", "close_link_on_expiration")
    )
    assert settings["namespace"] == "reds"


def test_host_with_name_listens_on_all_its_addresses() -> None:
    mission = in_the_field("turtlebot3_pair", lambda i: f"tls/robot{i}.local:7460")
    assert configured(mission, "robot1")["listen"]["endpoints"] == ["tls/[::]:7460"]
    assert configured(mission, "robot1")["connect"]["endpoints"] == ["tls/robot0.local:7460"]


def test_unknown_process_is_refused() -> None:
    with pytest.raises(Refusal, match="'robot9': must be one of leader, robot1, robot2, monitor, operator"):
        access.configuration(MISSIONS["turtlebot3_pair"], "robot9", Path("/tmp"))  # noqa: S108 - only a name
