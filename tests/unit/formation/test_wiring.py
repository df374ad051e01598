"""Links by the measurement graph, and bus settings by flags, files and missions."""

from __future__ import annotations

import json
from itertools import combinations
from pathlib import Path
from typing import Any

import pytest

from formation.mission.file import load, parse, read, shipped
from formation.mission.model import Mission
from formation.transport import wiring
from formation.transport.bus_config import DEFAULTS, BusConfig, BusError, parse_override
from formation.transport.session import settings_of
from formation.transport.wiring import Links
from tests.support.missions import edited

STANDBYS = "[standbys.north]\n[standbys.south]\n"
LEADERS = ("robot1", "north", "south")
SIX = "\n".join(line for line in read("six_robots")[0].split("\n") if not line.startswith("avoid ="))
"""The six robots; each avoids only robots that it measures."""
FALLBACK = edited(SIX, "robots.robot6", 'fallback_neighbours = ["robot2", "robot1"]')


def links(mission: Mission) -> set[frozenset[str]]:
    """All links of the team; asserts that each is dialled once and that every process listens once."""
    where = wiring.endpoints(mission)
    owner = {endpoint: name for name, endpoint in where.agents.items()}
    of = {name: wiring.of_member(mission, name, where) for name in (*mission.followers, *mission.candidates)}
    for name, ends in of.items():
        assert ends.listen == (where.agents[name],)
    dialled = [frozenset((name, owner[end])) for name, ends in of.items() for end in ends.connect]
    assert len(dialled) == len(set(dialled))
    return set(dialled)


def measured(mission: Mission) -> set[frozenset[str]]:
    return {frozenset((i, j)) for i in mission.names for j in mission.robots[i].neighbours}


def among(*names: str) -> set[frozenset[str]]:
    return {frozenset(pair) for pair in combinations(names, 2)}


def test_avoiding_robots_are_linked_but_leader_is_not() -> None:
    mission = parse(edited(SIX, "robots.robot2", 'avoid = ["robot6"]'))
    assert links(mission) == measured(mission) | among("robot2", "robot6")
    all_avoid = parse(edited(SIX, "robot", 'avoid = "all"'))
    assert links(all_avoid) == measured(all_avoid) | among(*all_avoid.followers)


def test_leaders_and_fallback_neighbours_are_linked() -> None:
    """Fallback neighbours are linked from the start; candidates and a leader with cohesion, to all robots."""
    fallback, patient, shared = map(parse, (FALLBACK, SIX + "[cohesion]\nerror = 0.5\n", SIX + STANDBYS))
    assert links(fallback) == measured(fallback) | among("robot6", "robot2") | among("robot6", "robot1")
    team = {frozenset((one, name)) for one in LEADERS for name in shared.followers}
    assert links(patient) == measured(patient) | {link for link in team if "robot1" in link}
    assert links(shared) == measured(shared) | team | among(*LEADERS)
    assert wiring.partners(fallback, "robot2") == ("robot1", "robot3", "robot4", "robot6")


@pytest.mark.parametrize("name", [name for name in shipped() if not load(name).standbys])
def test_links_exist_exactly_where_robots_receive_positions(name: str) -> None:
    mission = load(name)
    assert links(mission) == {frozenset((i, j)) for i in mission.names for j in mission.received_by(i)}


def test_standby_dials_all_processes_declared_before_it() -> None:
    mission = parse(SIX + STANDBYS)
    assert wiring.called(mission, "robot1") == ()
    assert wiring.called(mission, "north") == mission.names
    assert wiring.called(mission, "south") == (*mission.names, "north")
    assert wiring.partners(mission, "robot1") == (*mission.followers, "north", "south")


def test_standby_ports_follow_the_robots_ports() -> None:
    before, after = wiring.endpoints(parse(SIX)), wiring.endpoints(parse(SIX + STANDBYS))
    more = {"north": "tcp/127.0.0.1:7466", "south": "tcp/127.0.0.1:7467"}
    assert after.robots == before.robots
    assert dict(after.agents) == {**before.agents, **more}
    named = parse(SIX + '[standbys.north]\nendpoint = "tcp/192.168.1.9:7460"\n')
    assert wiring.endpoints(named).agents["north"] == "tcp/192.168.1.9:7460"


def test_by_endpoint_groups_robots_by_endpoint() -> None:
    where = {"robot2": "tcp/desk:7447", "robot3": "tcp/c:1", "robot4": "tcp/desk:7447"}
    assert wiring.by_endpoint(where) == {"tcp/desk:7447": ("robot2", "robot4"), "tcp/c:1": ("robot3",)}


def test_simulated_sensor_of_virtual_leader_is_linked() -> None:
    sensing = SIX.replace("rate = 20 ", 'rate = 20\nmeasurement = "local" ')
    for text, robots, leaders in (
        (SIX, ["robot2", "robot3"], ()),
        (sensing, parse(SIX).followers, ("robot1",)),
        (sensing, ["robot4"], ()),  # it measures robot2 and robot3
        (sensing + STANDBYS, parse(SIX).followers, LEADERS),
    ):
        mission = parse(text)
        where = wiring.endpoints(mission)
        assert wiring.of_robots(mission, robots, where) == ((), tuple(where.agents[name] for name in leaders))


@pytest.mark.parametrize("standbys", ["", STANDBYS])
def test_monitor_dials_every_agent_and_does_not_listen(standbys: str) -> None:
    where = wiring.endpoints(parse(SIX + standbys))
    monitor = wiring.of_monitor(where)
    assert (monitor.listen, set(monitor.connect)) == ((), set(where.agents.values()))


def test_endpoints_of_shipped_missions_are_unique() -> None:
    for name in shipped():
        where = wiring.endpoints(load(name))
        listened = [*where.agents.values(), *where.robots.values()]
        assert len(listened) == len(set(listened))


def setting(config: BusConfig, path: str) -> Any:
    return json.loads(settings_of(config).get_json(path))


def another(value: Any) -> Any:
    """A legal value that differs from `value` throughout."""
    if isinstance(value, dict):
        return {key: another(one) for key, one in value.items()}
    if isinstance(value, bool):
        return not value
    return ["tcp/127.0.0.1:7447"] if isinstance(value, list) else value + 1


@pytest.mark.parametrize("path", [path for path, _ in DEFAULTS])
def test_every_default_of_a_session_can_be_overridden(path: str) -> None:
    value = setting(BusConfig(), path)
    assert value is not None
    wanted = another(value)
    assert setting(BusConfig(overrides=((path, json.dumps(wanted)),)), path) == wanted


def test_session_neither_scouts_nor_listens_by_default() -> None:
    config = BusConfig(connect=("tcp/127.0.0.1:7447",))
    for path, value in (
        ("scouting/multicast/enabled", False),
        ("scouting/gossip/enabled", False),
        ("listen/endpoints", []),
        ("connect/endpoints", ["tcp/127.0.0.1:7447"]),
        ("connect/timeout_ms", None),
    ):
        assert setting(config, path) == value, path


def test_settings_precedence_is_overrides_then_flags_then_file(tmp_path: Path) -> None:
    def settings(config: BusConfig) -> list[Any]:
        paths = ("mode", "listen/endpoints", "transport/link/tx/lease", "scouting/multicast/enabled")
        return [setting(config, path) for path in paths]

    file = tmp_path / "zenoh.json5"
    file.write_text(
        '{ mode: "client", // JSON5\n listen: {endpoints: ["tcp/127.0.0.1:1"]},'
        " transport: {link: {tx: {lease: 3000}}} }"
    )
    flags: dict[str, Any] = {"config_file": file, "mode": "peer", "listen": ("tcp/127.0.0.1:2",)}
    overrides = (("mode", '"router"'), ("transport/link/tx/lease", "500"))
    assert settings(BusConfig(config_file=file)) == ["client", ["tcp/127.0.0.1:1"], 3000, False]
    assert settings(BusConfig(**flags)) == ["peer", ["tcp/127.0.0.1:2"], 3000, False]
    assert settings(BusConfig(**flags, overrides=overrides)) == ["router", ["tcp/127.0.0.1:2"], 500, False]


def test_endpoint_precedence_is_flags_then_file_then_mission(tmp_path: Path) -> None:
    def links(**flags: Any) -> tuple[Any, Any]:
        config = BusConfig(**flags)
        return setting(config, "listen/endpoints"), setting(config, "connect/endpoints")

    file = tmp_path / "zenoh.json5"
    file.write_text("{transport: {link: {tx: {lease: 3000}}}}")
    implied = Links(("tcp/127.0.0.1:1",), ("tcp/127.0.0.1:2",))
    assert links(implied=implied) == (["tcp/127.0.0.1:1"], ["tcp/127.0.0.1:2"])
    assert links(implied=implied, config_file=file) == (["tcp/127.0.0.1:1"], ["tcp/127.0.0.1:2"])
    file.write_text('{connect: {endpoints: ["tls/robot3:7"]}}')
    assert links(implied=implied, config_file=file) == ([], ["tls/robot3:7"])
    assert links(config_file=file, listen=("tcp/[::]:8",)) == (["tcp/[::]:8"], ["tls/robot3:7"])
    assert links(config_file=file, connect=("tcp/b:9",)) == ([], ["tcp/b:9"])


def test_namespace_name_and_adminspace_are_set_in_zenoh() -> None:
    config = BusConfig(namespace="red/one", name="agent robot2", adminspace=False)
    assert setting(config, "namespace") == "red/one"
    assert setting(config, "metadata") == {"name": "agent robot2"}
    assert setting(config, "adminspace/enabled") is False


@pytest.mark.parametrize(
    "endpoint",
    [
        "tcp/127.0.0.1:7447", "tls/robot2.local:7447", "tcp/[::1]:7447", "tcp/[fe80::1%eth0]:7447",
        "udp/10.0.0.1:1", "quic/host:65535", "ws/host:80", "tcp/host:7447?prio=1-3", "tcp/host:7447#iface=lo",
        "unixsock-stream/run/formation.sock", "serial/dev/ttyUSB0",
    ],
)  # fmt: skip
def test_usual_zenoh_endpoints_are_accepted(endpoint: str) -> None:
    assert BusConfig(listen=(endpoint,), connect=(endpoint,)).connect == (endpoint,)


@pytest.mark.parametrize(
    "endpoint",
    [
        "", "tcp", "tcp/", "127.0.0.1:7447", "tcp/127.0.0.1", "tcp/:7447", "tcp/host:", "tcp/host:99999",
        "tcp/host:-1", "tcp/::1:7447", "http/host:80", "tcp/host:80 ", "tcp://host:80", "serial/",
    ],
)  # fmt: skip
@pytest.mark.parametrize("flag", ["listen", "connect"])
def test_error_names_invalid_endpoint_and_legal_form(flag: str, endpoint: str) -> None:
    with pytest.raises(BusError) as refusal:
        BusConfig(**{flag: (endpoint,)})  # type: ignore[arg-type]
    assert str(refusal.value).startswith(
        f"--{flag} {endpoint!r}: must be PROTOCOL/HOST:PORT with one of tcp, tls"
    )


def test_port_0_is_legal_for_listen_not_for_connect() -> None:
    assert BusConfig(listen=("tcp/127.0.0.1:0",)).listen
    with pytest.raises(BusError, match="from 1 to 65535"):
        BusConfig(connect=("tcp/127.0.0.1:0",))
    with pytest.raises(BusError, match="--connect 'tcp/nowhere'"):
        BusConfig(implied=Links((), ("tcp/nowhere",)))


@pytest.mark.parametrize("mode", ["", "Peer", "node"])
def test_error_names_unknown_mode_and_known_modes(mode: str) -> None:
    with pytest.raises(BusError, match=f"--mode '{mode}': must be one of peer, client, router"):
        BusConfig(mode=mode)


@pytest.mark.parametrize("namespace", ["/", "red/", "/red", "red//blue", "re*d", "@red", "red blue", "re?d"])
def test_namespace_that_is_no_prefix_is_refused(namespace: str) -> None:
    with pytest.raises(BusError, match="--namespace"):
        BusConfig(namespace=namespace)


def test_parse_override_splits_path_and_value() -> None:
    assert parse_override("transport/link/tx/lease:2000") == ("transport/link/tx/lease", "2000")
    assert parse_override('listen/endpoints:["tcp/[::]:7447"]') == ("listen/endpoints", '["tcp/[::]:7447"]')
    for text in ("", "mode", ":1", "mode:"):
        with pytest.raises(BusError, match="must be PATH:VALUE"):
            parse_override(text)


def refusal(config: BusConfig) -> str:
    """The error that `config` causes; asserts that it names no place in Zenoh's source."""
    with pytest.raises(BusError) as caught:
        setting(config, "mode")
    assert ".rs" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(
    ("path", "value", "reason"),
    [
        ("no/such/path", "1", "unknown key"),
        ("mode", '"node"', "expected one of `router`, `peer`, `client`"),
        ("mode", "peer", "expected"),
        ("transport/link/tx/lease", '"x"', "number"),
    ],
)
def test_refused_override_is_named_without_source_location(path: str, value: str, reason: str) -> None:
    error = refusal(BusConfig(overrides=((path, value),)))
    assert error.startswith(f"--cfg {path}:{value}: ")
    assert reason in error


@pytest.mark.parametrize(
    ("text", "reason"),
    [("{mode:", "expected"), ("{mood: 1}", "unknown field `mood`"), (None, "No such file")],
)
def test_error_names_unreadable_configuration_file(tmp_path: Path, text: str | None, reason: str) -> None:
    file = tmp_path / "zenoh.json5"
    if text is not None:
        file.write_text(text)
    error = refusal(BusConfig(config_file=file))
    assert error.startswith(f"--config '{file}': ")
    assert reason in error
