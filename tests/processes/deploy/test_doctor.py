"""`formation doctor` with real agents and watchdogs, and with emulated TurtleBot3s."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from formation.deploy.fleet import access, certificates
from formation.mission.file import load, read
from formation.transport.bus import Bus, BusConfig
from tests.processes.agent.turtlebot3 import TurtleBot3, Wire
from tests.support.child import PATIENCE, Child, free_endpoint, started, until

pytestmark = pytest.mark.processes

NAMES, FOLLOWERS = ("leader", "robot1", "robot2"), ("robot1", "robot2")


class Report(NamedTuple):
    """Result of one `formation doctor`."""

    code: int
    findings: dict[str, list[str]]
    """Names of the findings, by robot."""
    text: str

    @property
    def one_line(self) -> str:
        """The text on one line."""
        return " ".join(self.text.split())


class Team:
    """A mission whose processes are started one by one."""

    def __init__(self, folder: Path, wire: Wire, takes: str, stack: ExitStack) -> None:
        """Start emulated robots that publish as `wire` and take messages of type `takes` on cmd_vel."""
        text, _ = read("turtlebot3_pair")
        text = text.replace('avoid = "all"', "avoid = []")  # each robot needs the leader only
        self.agents = {name: free_endpoint() for name in NAMES}
        self.routers = {name: free_endpoint() for name in FOLLOWERS}
        for name in NAMES:
            keys = f'endpoint = "{self.agents[name]}"\n'
            if name in self.routers:
                keys += f'robot_endpoint = "{self.routers[name]}"\nros = "{wire.ros}"\n'
            text = text.replace(f"[robots.{name}]\n", f"[robots.{name}]\n{keys}")
        self.path = folder / "pair.toml"
        self.path.write_text(text, encoding="utf-8")
        self.mission = load(self.path)
        self._stack = stack
        self.robots: dict[str, TurtleBot3] = {}
        for name in FOLLOWERS:
            start = self.mission.robots[name].start
            played = Wire(wire.ros, takes, wire.domain, name)
            robot = TurtleBot3(played, self.routers[name], start.position, start.heading)
            self.robots[name] = stack.enter_context(robot)

    def start(self, module: str, *arguments: str) -> Child:
        child = self._stack.enter_context(started(module, str(self.path), *arguments))
        child.event("ready")
        return child

    def doctor(self, *arguments: str, seconds: float = 2.0) -> Report:
        words = ["doctor", str(self.path), "--seconds", str(seconds), "--json", *arguments]
        done = subprocess.run(
            [sys.executable, "-m", "formation.deploy", *words],
            capture_output=True, text=True, timeout=2.0 * PATIENCE, check=False,
        )  # fmt: skip
        assert done.returncode in {0, 1}, done.stderr
        robots: dict[str, Any] = json.loads(done.stdout)["robots"]
        findings = {
            name: [finding["name"] for one in checks.values() for finding in one["findings"]]
            for name, checks in robots.items()
        }
        return Report(done.returncode, findings, done.stderr.rstrip())


@contextmanager
def team(folder: Path, wire: Wire | None = None, takes: str = "twist_stamped") -> Iterator[Team]:
    with ExitStack() as stack:
        yield Team(folder, wire or Wire(), takes, stack)


def await_status(team: Team, robot: str, word: str) -> None:
    """Wait until the status of the robot's agent contains `word`."""
    deadline = time.monotonic() + PATIENCE
    with Bus(BusConfig(connect=(team.agents[robot],))) as bus:
        bus.subscribe(f"{robot}/status")
        while not any(word.encode() in sample.payload for sample in bus.drain()):
            assert bus.wait(deadline - time.monotonic()), f"{robot} has no status with {word}"


def start_followers(team: Team, *robots: str) -> dict[str, tuple[Child, Child]]:
    """Start the watchdog and the agent of each robot; wait until all robots run."""
    children = {}
    for name in robots:
        watchdog = team.start("formation.agent.watchdog", "--robot", name)
        children[name] = watchdog, team.start("formation.agent", "--robot", name)
    for name in robots:
        await_status(team, name, "run")
    return children


@pytest.mark.parametrize("ros", ["ros2dds", "rmw_zenoh"])
def test_doctor_follows_team_from_health_through_faults(tmp_path: Path, ros: str) -> None:
    with team(tmp_path, Wire(ros)) as fleet:
        fleet.start("formation.leader")
        followers = start_followers(fleet, *FOLLOWERS)
        there = fleet.doctor("--robot", "robot1")
        assert (there.code, there.findings) == (0, {"robot1": []}), there.text
        assert there.text.endswith("healthy: nothing is wrong")
        desk = fleet.doctor()
        assert (desk.code, desk.findings) == (0, {name: [] for name in NAMES}), desk.text
        assert all(robot.taken and robot.troubles == {} for robot in fleet.robots.values())
        if ros == "ros2dds":
            _check_changed_mission(fleet)
            _check_second_agent(fleet)
            _check_lost_route(fleet)
            _check_killed_agent(fleet, followers["robot1"])


def _check_changed_mission(fleet: Team) -> None:
    text = fleet.path.read_text(encoding="utf-8")
    fleet.path.write_text(text.replace("k_p = 2.0", "k_p = 1.5") + "\n# after they were started\n", "utf-8")
    desk = fleet.doctor()
    assert desk.findings == {name: ["mission-other"] for name in NAMES}, desk.text
    fleet.path.write_text(text + "\n# a remark is no other mission\n", encoding="utf-8")
    assert fleet.doctor().findings == {name: [] for name in NAMES}


def _check_second_agent(fleet: Team) -> None:
    ends = ("-l", free_endpoint(), "-e", fleet.agents["leader"])
    second = fleet.start("formation.agent", "--robot", "robot1", *ends)
    there = fleet.doctor("--robot", "robot1")
    assert there.code == 1
    assert "agents-two" in there.findings["robot1"], there.text
    second.process.kill()
    second.wait()


def _check_lost_route(fleet: Team) -> None:
    fleet.robots["robot2"].lose_route()
    await_status(fleet, "robot2", "no listener on cmd_vel")
    there = fleet.doctor("--robot", "robot2")
    assert (there.code, there.findings) == (1, {"robot2": ["route-lost"]}), there.text
    desk = fleet.doctor()
    assert (desk.findings["robot1"], desk.findings["robot2"]) == ([], ["route-lost"]), desk.text


def _check_killed_agent(fleet: Team, children: tuple[Child, Child]) -> None:
    """The doctor sends no command itself."""
    for child in children:
        child.process.kill()
        child.wait()
    until(lambda: not fleet.robots["robot1"].has_listener)  # commands on their way have arrived
    before = len(fleet.robots["robot1"].taken)
    there = fleet.doctor("--robot", "robot1")
    assert len(fleet.robots["robot1"].taken) == before
    assert (there.code, there.findings) == (1, {"robot1": ["agent-silent", "watchdog-down"]}), there.text
    desk = fleet.doctor()
    assert desk.findings["robot1"] == ["unreachable"], desk.text
    assert f"its agent at {fleet.agents['robot1']} refuses the connection" in desk.one_line


def test_doctor_on_desk_checks_standby_and_names_leader(tmp_path: Path) -> None:
    with team(tmp_path) as fleet:
        with fleet.path.open("a", encoding="utf-8") as file:
            file.write(f'\n[standbys.deputy]\nendpoint = "{free_endpoint()}"\n')
        silent = fleet.doctor()
        assert silent.findings["deputy"] == ["unreachable"], silent.text
        assert silent.findings["desk"] == ["no-leader"], silent.text
        fleet.start("formation.leader", "--standby", "deputy")
        start_followers(fleet, *FOLLOWERS)
        result = fleet.doctor()
        assert result.findings["deputy"] == result.findings["desk"] == [], result.text
        assert result.findings["leader"] == ["unreachable"], result.text
        assert "deputy said that it leads" in result.one_line


@pytest.mark.parametrize("ros", ["ros2dds", "rmw_zenoh"])
def test_doctor_reports_wrong_cmd_vel_type_with_remedy(tmp_path: Path, ros: str) -> None:
    with team(tmp_path, Wire(ros), takes="twist") as fleet:
        fleet.start("formation.leader")
        fleet.start("formation.agent.watchdog", "--robot", "robot1")
        there = fleet.doctor("--robot", "robot1")
        assert there.code == 1
        assert there.findings["robot1"] == ["agent-silent", "cmd-vel-type"], there.text
        assert "takes Twist on cmd_vel, but is sent TwistStamped" in there.one_line
        assert 'set cmd_vel = "twist" for robot1 in the mission' in there.one_line


def test_doctor_reports_missing_router_as_only_finding(tmp_path: Path) -> None:
    with team(tmp_path) as fleet:
        fleet.start("formation.leader")
        there = fleet.doctor("--robot", "robot1", "--robot-connect", free_endpoint())
        assert (there.code, there.findings) == (1, {"robot1": ["router-missing"]}), there.text


def test_doctor_accepts_certificates_and_reports_wrong_certificate_name(
    tmp_path: Path,
) -> None:
    with team(tmp_path) as fleet:
        text = fleet.path.read_text(encoding="utf-8")
        for end in fleet.agents.values():
            text = text.replace(end, end.replace("tcp", "tls"))
        fleet.path.write_text(text, encoding="utf-8")
        mission = load(fleet.path)
        secrets = tmp_path / "secrets"
        certificates.create(mission, secrets, days=30.0, authority_days=365.0, now=datetime.now(UTC))
        files = {}
        for name in access.processes(mission):
            files[name] = tmp_path / f"{name}.json5"
            settings = access.configuration(mission, name, secrets / name)
            files[name].write_text(access.text(mission, name, settings), encoding="utf-8")
        fleet.start("formation.leader", "-c", str(files["leader"]))
        for name in FOLLOWERS:
            fleet.start("formation.agent.watchdog", "--robot", name)
            fleet.start("formation.agent", "--robot", name, "-c", str(files[name]))
        operator = ("-c", str(files["operator"]), "--certificates", str(secrets))
        for _ in range(2):
            there = fleet.doctor("--robot", "robot1", "-c", str(files["robot1"]))
            assert (there.code, there.findings) == (0, {"robot1": []}), there.text
            desk = fleet.doctor(*operator)
            assert (desk.code, desk.findings) == (0, {name: [] for name in ("desk", *NAMES)}), desk.text
        assert "robot1 is valid for 30 days" in there.one_line
        strange = fleet.doctor("--robot", "robot1", "-c", str(files["robot2"]))
        assert strange.findings == {"robot1": ["certificate-name"]}
