from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from formation.transport.bus_config import DEFAULTS, BusConfig, BusError, parse_override
from formation.transport.session import settings_of
from formation.transport.wiring import Links


def setting(config: BusConfig, path: str) -> Any:
    return json.loads(settings_of(config).get_json(path))


@pytest.mark.parametrize("path", [path for path, _ in DEFAULTS])
def test_zenoh_accepts_every_default_and_flags_override_it(path: str) -> None:
    value = setting(BusConfig(), path)
    assert value is not None
    assert setting(BusConfig(overrides=((path, json.dumps(value)),)), path) == value


def test_session_neither_scouts_nor_listens_by_default() -> None:
    config = BusConfig(connect=("tcp/127.0.0.1:7447",))
    assert setting(config, "scouting/multicast/enabled") is False
    assert setting(config, "scouting/gossip/enabled") is False
    assert setting(config, "listen/endpoints") == []
    assert setting(config, "connect/endpoints") == ["tcp/127.0.0.1:7447"]
    assert setting(config, "connect/timeout_ms") is None


def test_flags_outrank_the_file_and_overrides_outrank_both(tmp_path: Path) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text(
        '{ mode: "client", // JSON5\n listen: {endpoints: ["tcp/127.0.0.1:1"]},'
        " transport: {link: {tx: {lease: 3000}}} }"
    )
    config = BusConfig(config_file=file)
    assert setting(config, "mode") == "client"
    assert setting(config, "listen/endpoints") == ["tcp/127.0.0.1:1"]
    assert setting(config, "transport/link/tx/lease") == 3000
    assert setting(config, "scouting/multicast/enabled") is False
    config = BusConfig(config_file=file, mode="peer", listen=("tcp/127.0.0.1:2",))
    assert setting(config, "mode") == "peer"
    assert setting(config, "listen/endpoints") == ["tcp/127.0.0.1:2"]
    config = BusConfig(
        config_file=file, mode="peer", overrides=(("mode", '"router"'), ("transport/link/tx/lease", "500"))
    )
    assert setting(config, "mode") == "router"
    assert setting(config, "transport/link/tx/lease") == 500


def test_endpoint_precedence_is_flags_then_file_then_mission(
    tmp_path: Path,
) -> None:
    def links(config: BusConfig) -> tuple[Any, Any]:
        return setting(config, "listen/endpoints"), setting(config, "connect/endpoints")

    mission = Links(("tcp/127.0.0.1:1",), ("tcp/127.0.0.1:2",))
    file = tmp_path / "zenoh.json5"
    file.write_text("{transport: {link: {tx: {lease: 3000}}}}")
    assert links(BusConfig(implied=mission)) == (["tcp/127.0.0.1:1"], ["tcp/127.0.0.1:2"])
    assert links(BusConfig(implied=mission, config_file=file)) == (["tcp/127.0.0.1:1"], ["tcp/127.0.0.1:2"])
    file.write_text('{connect: {endpoints: ["tls/robot3:7"]}}')
    assert links(BusConfig(implied=mission, config_file=file)) == ([], ["tls/robot3:7"])
    assert links(BusConfig(config_file=file, listen=("tcp/[::]:8",))) == (["tcp/[::]:8"], ["tls/robot3:7"])
    assert links(BusConfig(config_file=file, connect=("tcp/b:9",))) == ([], ["tcp/b:9"])


def test_an_implied_endpoint_that_cannot_be_is_named() -> None:
    with pytest.raises(BusError, match="--connect 'tcp/nowhere'"):
        BusConfig(implied=Links((), ("tcp/nowhere",)))


def test_the_namespace_and_the_name_reach_zenoh() -> None:
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
def test_the_endpoints_that_zenoh_users_write_are_legal(endpoint: str) -> None:
    assert BusConfig(listen=(endpoint,), connect=(endpoint,)).connect == (endpoint,)


@pytest.mark.parametrize(
    "endpoint",
    [
        "", "tcp", "tcp/", "127.0.0.1:7447", "tcp/127.0.0.1", "tcp/:7447", "tcp/host:", "tcp/host:99999",
        "tcp/host:-1", "tcp/::1:7447", "http/host:80", "tcp/host:80 ", "tcp://host:80", "serial/",
    ],
)  # fmt: skip
@pytest.mark.parametrize("flag", ["listen", "connect"])
def test_an_endpoint_that_cannot_be_is_named_with_what_is_legal(flag: str, endpoint: str) -> None:
    with pytest.raises(BusError) as refusal:
        BusConfig(**{flag: (endpoint,)})  # type: ignore[arg-type]
    assert str(refusal.value).startswith(
        f"--{flag} {endpoint!r}: must be PROTOCOL/HOST:PORT with one of tcp, tls"
    )


def test_any_free_port_can_be_listened_on_but_not_dialled() -> None:
    assert BusConfig(listen=("tcp/127.0.0.1:0",)).listen
    with pytest.raises(BusError, match="from 1 to 65535"):
        BusConfig(connect=("tcp/127.0.0.1:0",))


@pytest.mark.parametrize("mode", ["", "Peer", "node"])
def test_an_unknown_mode_is_named_with_the_known_ones(mode: str) -> None:
    with pytest.raises(BusError, match=f"--mode '{mode}': must be one of peer, client, router"):
        BusConfig(mode=mode)


@pytest.mark.parametrize("namespace", ["/", "red/", "/red", "red//blue", "re*d", "@red", "red blue", "re?d"])
def test_a_namespace_that_is_no_prefix_is_named(namespace: str) -> None:
    with pytest.raises(BusError, match="--namespace"):
        BusConfig(namespace=namespace)


def test_an_override_is_a_path_and_a_value() -> None:
    assert parse_override("transport/link/tx/lease:2000") == ("transport/link/tx/lease", "2000")
    assert parse_override('listen/endpoints:["tcp/[::]:7447"]') == ("listen/endpoints", '["tcp/[::]:7447"]')


@pytest.mark.parametrize("text", ["", "mode", ":1", "mode:"])
def test_half_an_override_is_refused(text: str) -> None:
    with pytest.raises(BusError, match="must be PATH:VALUE"):
        parse_override(text)


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
    with pytest.raises(BusError) as refusal:
        setting(BusConfig(overrides=((path, value),)), "mode")
    assert str(refusal.value).startswith(f"--cfg {path}:{value}: ")
    assert reason in str(refusal.value)
    assert ".rs" not in str(refusal.value)


@pytest.mark.parametrize(
    ("text", "reason"),
    [("{mode:", "expected"), ("{mood: 1}", "unknown field `mood`"), (None, "No such file")],
)
def test_a_configuration_file_that_cannot_be_read_is_named(
    tmp_path: Path, text: str | None, reason: str
) -> None:
    file = tmp_path / "zenoh.json5"
    if text is not None:
        file.write_text(text)
    with pytest.raises(BusError) as refusal:
        setting(BusConfig(config_file=file), "mode")
    assert str(refusal.value).startswith(f"--config '{file}': ")
    assert reason in str(refusal.value)
    assert ".rs" not in str(refusal.value)
