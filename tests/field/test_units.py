"""The systemd units of a robot."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

from formation.deploy.fleet import units
from formation.deploy.refusal import Refusal
from formation.mission.file import parse
from formation.mission.model import Mission
from tests.field.deployed import TEXT, commands, mission
from tests.support.needs import path_of

FIELD = mission()
RATED = ("--offline=true", "--threshold=20", "--no-pager")
STANDBY = parse(TEXT + '[standbys.deputy]\nendpoint = "tls/10.77.0.4:7460"\n')
RMW = parse(TEXT.replace("[robot]", '[robot]\nros = "rmw_zenoh"\ndomain = 7'))


UNITS = [(FIELD, name) for name in FIELD.names] + [(STANDBY, "deputy")]


def value(unit: str, key: str) -> str:
    """The last value of a key in a unit."""
    values: list[str] = re.findall(rf"(?m)^{key}=(.*)$", unit)
    return values[-1]


def every_unit(of: Mission, name: str, **flags: str) -> dict[str, str]:
    return {**units.units(of, name, **flags), **units.samples(of, name, **flags)}


def verified(texts: dict[str, str], root: Path) -> str:
    """Output of `systemd-analyze verify`, with empty scripts as executables."""
    folder, program = root / "units", root / "opt" / "formation" / "current" / "venv" / "bin" / "formation"
    folder.mkdir()
    bridge = root / "zenoh-bridge-ros2dds"
    program.parent.mkdir(parents=True)
    for path in (program, bridge):
        path.write_text("#!/bin/sh\n")
        path.chmod(0o755)
    for name, text in texts.items():
        here = text.replace(units.PREFIX, str(root / "opt" / "formation"))
        (folder / name).write_text(here.replace("/usr/bin/zenoh-bridge-ros2dds", str(bridge)))
    done = subprocess.run(
        [path_of("systemd-analyze"), "verify", "--man=no", *map(str, folder.glob("*.service"))],
        env={**os.environ, "SYSTEMD_UNIT_PATH": f"{folder}:", "SYSTEMD_LOG_TARGET": "console"},
        capture_output=True,
        text=True,
        check=False,
    )
    ours = [line for line in done.stderr.splitlines() if str(folder) in line or line.startswith(tuple(texts))]
    return "\n".join(ours) or ("" if done.returncode == 0 else done.stderr)


@pytest.mark.systemd
@pytest.mark.parametrize(
    ("of", "name"),
    [*UNITS, *((RMW, name) for name in RMW.names)],
    ids=lambda one: getattr(one, "name", one),
)
def test_systemd_analyze_accepts_every_unit(of: Mission, name: str, tmp_path: Path) -> None:
    assert verified(every_unit(of, name), tmp_path) == ""


@pytest.mark.systemd
def test_systemd_analyze_accepts_units_without_bringup_and_bridge(
    tmp_path: Path,
) -> None:
    assert verified(every_unit(FIELD, "robot1", bringup="none", bridge="none"), tmp_path) == ""


@pytest.mark.systemd
def test_systemd_analyze_reports_misspelt_key(tmp_path: Path) -> None:
    texts = every_unit(FIELD, "robot1")
    texts["formation-agent.service"] = texts["formation-agent.service"].replace("WatchdogSec", "WatchDogSec")
    assert "WatchDogSec" in verified(texts, tmp_path)


@pytest.mark.systemd
def test_systemd_security_rating_is_within_threshold(tmp_path: Path) -> None:
    for name in ("robot1", "leader", "deputy"):
        for unit, text in units.units(STANDBY, name).items():
            (tmp_path / unit).write_text(text.replace(units.PREFIX, "/opt/formation"))
            done = subprocess.run(
                [path_of("systemd-analyze"), "security", *RATED, str(tmp_path / unit)],
                capture_output=True,
                text=True,
                check=False,
            )
            assert done.returncode == 0, done.stdout


def test_agent_is_bound_to_bringup_and_bridge() -> None:
    agent = units.units(FIELD, "robot1")["formation-agent.service"]
    assert value(agent, "BindsTo") == "turtlebot3.service zenoh-bridge-ros2dds.service"
    assert value(agent, "WantedBy") == "turtlebot3.service"
    assert value(agent, "Requires") == "formation-watchdog.service"
    agent = units.units(RMW, "robot1", bringup="base.service")["formation-agent.service"]
    assert value(agent, "BindsTo") == "base.service rmw-zenohd.service"


def test_bringup_restarts_with_its_bridge_or_router() -> None:
    for of, bridge in ((FIELD, "zenoh-bridge-ros2dds.service"), (RMW, "rmw-zenohd.service")):
        texts = units.samples(of, "robot2")
        assert set(texts) - {"conf.json5"} == {"turtlebot3.service", bridge}
        for key in ("BindsTo", "After", "WantedBy"):
            assert value(texts["turtlebot3.service"], key) == bridge
        assert value(texts[bridge], "Restart") == "always"


def test_bridge_endpoint_and_bringup_namespace_match_mission() -> None:
    bridge = units.samples(FIELD, "robot2")["conf.json5"]
    assert 'listen: { endpoints: ["tcp/127.0.0.1:7447"] }' in bridge
    assert "multicast: { enabled: false }" in bridge
    assert (
        'publishers: [".*/odom", ".*/scan", ".*/relative/.*", ".*/pose", ".*/amcl_pose", ".*/tf"]' in bridge
    )
    router = units.samples(RMW, "robot2")["rmw-zenohd.service"]
    assert 'listen/endpoints=["tcp/127.0.0.1:7447"]' in router
    bringup = units.samples(RMW, "robot2")["turtlebot3.service"]
    assert "namespace:=robot2'" in bringup
    assert "ROS_DOMAIN_ID=7" in bringup
    bare = parse(TEXT.replace("[robot]", '[robot]\nnamespace = ""', 1))
    assert "namespace" not in units.samples(bare, "robot2")["turtlebot3.service"]


def test_units_are_not_ordered_after_bringup_or_bridge() -> None:
    for text in units.units(FIELD, "robot1").values():
        bound = {"turtlebot3.service", "zenoh-bridge-ros2dds.service"}
        assert not bound & set(" ".join(re.findall(r"(?m)^After=(.*)$", text)).split())


def test_leader_unit_holds_and_environment_file_is_optional() -> None:
    leader = units.units(FIELD, "leader")["formation-leader.service"]
    assert commands(leader)[0][-1] == "--hold"
    agent = units.units(FIELD, "robot1")["formation-agent.service"]
    assert "--readonly" not in commands(agent)[0]
    for text in (leader, agent):
        assert value(text, "EnvironmentFile") == "-/etc/default/formation"


def test_watchdog_needs_neither_network_nor_bringup() -> None:
    watchdog = units.units(FIELD, "robot1")["formation-watchdog.service"]
    for key in ("BindsTo", "Requires", "PartOf", "After"):
        assert not re.search(rf"(?m)^{key}=", watchdog)
    assert value(watchdog, "Before") == "formation-agent.service"


def test_every_unit_notifies_systemd_and_is_restarted() -> None:
    for of, name in UNITS:
        for text in units.units(of, name).values():
            assert value(text, "Type") == "notify"
            assert float(value(text, "WatchdogSec")) > 0.2 * 3
            assert value(text, "Restart") in {"always", "on-failure"}
            assert value(text, "StartLimitIntervalSec") == "0"  # any number of restarts
            assert value(text, "User") == "formation"
            assert value(text, "NoNewPrivileges") == "yes"


def test_watchdog_sends_zero_after_any_agent_exit() -> None:
    """The agent's unit then runs `formation watchdog --once` with the mission of the agent."""
    for name in ("robot1", "robot2"):
        agent, *after = commands(units.units(FIELD, name)["formation-agent.service"])
        program, mission = agent[0], agent[2]
        assert after == [[program, "watchdog", mission, "--robot", name, "--once"]]


def test_agent_state_is_in_systemd_state_directory() -> None:
    """`ProtectSystem=strict` permits no other folder, and a stop must outlive an upgrade."""
    for name in ("robot1", "robot2"):
        agent = units.units(FIELD, name)["formation-agent.service"]
        (words, _) = commands(agent, "/var/lib")
        assert words[words.index("--state") + 1] == f"/var/lib/{value(agent, 'StateDirectory')}"
        assert value(agent, "StateDirectoryMode") == "0700"
        assert value(agent, "ProtectSystem") == "strict"
        assert units.PREFIX not in words[words.index("--state") + 1]


@cache
def help_of(command: str) -> str:
    """What `formation COMMAND --help` prints."""
    words = [sys.executable, "-m", "formation.deploy", command, "--help"]
    return subprocess.run(words, capture_output=True, text=True, check=True).stdout


def test_unit_commands_use_existing_flags() -> None:
    for of, name in UNITS:
        for text in units.units(of, name).values():
            for program, command, *arguments in commands(text):
                assert program == "@PREFIX@/current/venv/bin/formation"
                assert arguments[0] == "@PREFIX@/current/mission.toml"
                flags = [word for word in arguments if word.startswith("-")]
                assert all(flag in help_of(command) for flag in flags), flags


def test_leader_has_no_watchdog_or_bringup_unit() -> None:
    assert set(units.units(FIELD, "leader")) == {"formation-leader.service"}
    assert units.samples(FIELD, "leader") == {}


def test_standby_unit_runs_leader_with_standby_name() -> None:
    texts = units.units(STANDBY, "deputy")
    assert set(texts) == {"formation-standby.service"}
    assert units.samples(STANDBY, "deputy") == {}
    standby, leader = texts["formation-standby.service"], units.units(STANDBY, "leader")
    current = "@PREFIX@/current"
    assert commands(standby) == [
        [f"{current}/venv/bin/formation", "leader", f"{current}/mission.toml", "--standby", "deputy", "-c",
         f"{current}/zenoh.json5", "--state", "%S/formation", "--hold"]
    ]  # fmt: skip
    (leader_text,) = leader.values()
    for key in ("WatchdogSec", "Restart", "RestartSec", "MemoryMax", "StartLimitIntervalSec"):
        assert value(standby, key) == value(leader_text, key)


def test_standbys_leave_other_units_unchanged() -> None:
    for name in FIELD.names:
        assert every_unit(STANDBY, name) == every_unit(FIELD, name)


def test_units_have_no_placeholder_except_prefix() -> None:
    for of, name in (*UNITS, *((RMW, name) for name in RMW.names)):
        for unit, text in every_unit(of, name).items():
            assert not re.findall(r"@(?!PREFIX@)[A-Z_]+@", text), unit


@pytest.mark.parametrize("flag", ["bringup", "bridge"])
def test_illegal_unit_name_is_refused(flag: str) -> None:
    with pytest.raises(Refusal, match=f"--{flag} 'my bring-up': must be the name of a unit"):
        units.units(FIELD, "robot1", **{flag: "my bring-up"})
