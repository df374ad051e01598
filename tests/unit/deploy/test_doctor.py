"""`formation doctor`: findings of its examinations, its report and its refusals."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

import pytest

from formation.deploy.doctor import gather
from formation.deploy.doctor.agent import two_ages
from formation.deploy.doctor.cli import COLOUR, EXAMINATIONS, PLAIN, style, words
from formation.deploy.doctor.facts import Chrony, Facts, Reached, RosNode, Stream, examine
from formation.deploy.doctor.gather import read_tracking
from formation.deploy.doctor.robot import ROBOT_LINK
from formation.deploy.doctor.tls import dial
from formation.mission.file import load, shipped
from formation.mission.model import Mission
from formation.protocol.reasons import Code, Reason
from formation.protocol.status import AgentState, LeaderState, LeaderStatus, RobotLink
from formation.protocol.status_codec import to_message
from formation.ros2.messages import encode
from formation.topics import STATUS
from formation.wire import Sample
from tests.unit.deploy.commands import Capsys, refused
from tests.unit.deploy.examined import (
    DAY,
    DESK,
    HEALTHY,
    STAMPED,
    TB3,
    TWIST,
    WALL,
    found,
    paused,
    signs,
    status_of,
    stream,
)


def test_healthy_robot_and_desk_have_no_findings() -> None:
    assert found(DESK) == found(HEALTHY) == {}
    checked = examine(EXAMINATIONS, HEALTHY)
    assert [one.title for one in checked] == [
        "agent", "mission", "robot", "watchdog", "odometry", "clock", "network", "certificate", "refusals",
    ]  # fmt: skip
    assert all(one.seen for one in checked)


@pytest.mark.parametrize("code", [Code.HELD_BY_OPERATOR, Code.STOPPED_BY_LEADER, Code.NO_ORDER])
def test_robot_that_stands_as_ordered_has_no_findings(code: Code) -> None:
    status = status_of(state=AgentState.HOLD, reason=Reason(code))
    assert found(replace(HEALTHY, newest_status=status)) == {}


def test_host_name_that_cannot_be_one_is_unknown() -> None:
    assert dial("tls/robot..local:7460", None).outcome == "unknown name"


def certificate(**changes: Any) -> Mapping[str, Any]:
    assert HEALTHY.certificate is not None
    return {"certificate": replace(HEALTHY.certificate, **changes)}


PROBLEMS: dict[str, tuple[Mapping[str, Any], str, str]] = {
    "odometry stamped late": ({"odometry": stream(behind=0.4)}, "clock-offset",
        "odometry is stamped 0.4 s ago"),
    "odometry repeated": ({"odometry": Stream(tuple(one._replace(stamp=WALL) for one in stream().received))},
        "odometry-repeated", "odometry is frozen: 59 of 60 messages repeat an earlier stamp"),
    "robot does not move": (
        {"newest_status": status_of(state=AgentState.HOLD, reason=Reason(Code.OUTSIDE_BOUNDS,
            {"axis": "x", "value": 31.2, "limit": 25.0}))},
        "agent-stands", "its agent says hold: outside the bounds: x = 31.20 m, limit 25.00 m"),
    "odometry stamped ahead": ({"odometry": stream(behind=-5.0)}, "clock-offset", "stamped 5 s ahead"),
    "position stamped late": ({"position": stream(behind=0.2)}, "clock-offset", "its position is stamped"),
    "clock of a neighbour": ({"newest_status": status_of(clock={"leader": -0.3})}, "clock-doubted",
        "does not believe the stamps of leader"),
    "chrony without server": ({"chrony": Chrony(0.0, synchronised=False)}, "clock-unsynchronised",
        "no time server"),
    "chrony still far off": ({"chrony": Chrony(-0.7, synchronised=True)}, "clock-not-settled", "0.7 s from"),
    "no odometry": ({"odometry": Stream()}, "odometry-silent", "no odometry in 3 s"),
    "slow odometry": ({"odometry": stream(8.0)}, "odometry-slow", "at 8 Hz instead of 20 Hz"),
    "fast odometry": ({"odometry": stream(40.0)}, "odometry-fast", "at 40 Hz instead of 20 Hz"),
    "irregular odometry": ({"odometry": paused(0.2, 0.3)}, "odometry-irregular", "paused 2 times in 3 s"),
    "two odometry frames": ({"odometry": stream(frames=("odom", "map"))}, "odometry-frames",
        "several frames: map, odom"),
    "unreadable odometry": (
        {"odometry": replace(stream(), bad=("orientation has length 0, must be 1",))},
        "odometry-unreadable", "orientation has length 0",
    ),
    "no external pose": ({"pose": Stream()}, "pose-silent", "no external pose in 3 s"),
    "neighbour refuses": ({"reached": {"leader": Reached("tls/h:1", "refused")}}, "unreachable",
        "the leader at tls/h:1 refuses"),
    "no route": ({"reached": {"robot2": Reached("tls/h:1", "no route")}}, "unreachable",
        "robot2's agent at tls/h:1"),
    "no answer": ({"reached": {"robot2": Reached("tls/h:1", "no answer")}}, "unreachable", "does not answer"),
    "unknown name": ({"reached": {"robot2": Reached("tls/h:1", "unknown name")}}, "unreachable",
        "name cannot be resolved"),
    "no TLS": ({"reached": {"robot2": Reached("tls/h:1", "no TLS")}}, "unreachable", "does not use TLS"),
    "certificate not trusted": (
        {"reached": {"robot2": Reached("tls/h:1", "untrusted", "certificate has expired")}},
        "unreachable", "not to be trusted (certificate has expired)",
    ),
    "certificate refused": ({"reached": {"robot2": Reached("tls/h:1", "turned away", "unknown ca")}},
        "unreachable", "refuses our certificate (unknown ca)"),
    "addresses mixed up": (
        {"reached": {"robot2": Reached("tls/h:1", "ok", name="robot1")}},
        "neighbour-misnamed", "where robot2 should be, robot1 answers",
    ),
    "silent neighbour": ({"newest_status": status_of(age={"leader": 7.3})}, "neighbour-silent",
        "leader has been silent for 7.3 s"),
    "refused neighbour": (
        {"newest_status": status_of(age={"leader": 7.3}, dropped_last={"leader/position": "late: 0.6 s"})},
        "neighbour-silent", "leader has been silent for 7.3 s; newest refusal: late: 0.6 s",
    ),
    "no router": (
        {"router_error": "silent", "routed": None, "watchdog_state": None, "odometry": Stream(),
         "status": Stream()},
        "router-missing", "nothing answers at tcp/127.0.0.1:7447",
    ),
    "route lost": ({"routed": False, "subscribers": ()}, "route-lost", "nothing listens to cmd_vel"),
    "wrong cmd_vel type": (
        {"routed": False, "subscribers": (RosNode("turtlebot3_node", TWIST),)}, "cmd-vel-type",
        "turtlebot3_node takes Twist on cmd_vel, but is sent TwistStamped"),
    "second cmd_vel publisher": (
        {"publishers": (*HEALTHY.publishers, RosNode("teleop_twist_keyboard", STAMPED))},
        "cmd-vel-contested", "teleop_twist_keyboard publishes on cmd_vel as well",
    ),
    "no watchdog": ({"watchdog_state": "", "watchdog_unit": None}, "watchdog-down", "no watchdog answers"),
    "watchdog failed": ({"watchdog_unit": "failed"}, "watchdog-down", "systemd calls it failed"),
    "agent silent": ({"status": Stream(), "newest_status": None, "alive": ()}, "agent-silent",
        "no status in 3 s"),
    "agent died while listening": ({"ended": 103.8}, "agent-silent",
        "its agent fell silent: newest status 1.3 s old; limit 1 s"),
    "unreadable status": (
        {"status": Stream(bad=("status: kind is missing, must be agent",)), "newest_status": None,
         "alive": ()},
        "agent-unreadable", "1 statuses of its agent cannot be read: status: kind is missing",
    ),
    "two agents": ({"alive": tuple(sorted(signs(50.0) + signs(7.0)))}, "agents-two",
        "one runs for 53 s, one for 10 s"),
    "two agents started together": ({"alive": tuple(sorted(signs(50.0) + signs(50.2)))}, "agents-two",
        "one runs for 53 s, one for 53 s"),
    "second publisher": ({"doubled": ("robot2",)}, "agents-two",
        "robot2 receives its positions from two agents"),
    "second publisher of a neighbour": (
        {"newest_status": status_of(contested=("robot2",))},
        "neighbour-doubled", "positions of robot2 from two agents",
    ),
    "refused messages": ({"newest_status": status_of(refused={"put robot3/position": 12})}, "refused",
        "refused 12 times: put robot3/position"),
    "started with another mission": ({"newest_status": status_of(mission="0123456789ab")}, "mission-other",
        "its agent was started with another mission"),
    "neighbour on another mission": (
        {"newest_status": status_of(other_mission={"robot2": "89ef4567"})},
        "mission-mixed", "robot2 runs mission 89ef4567",
    ),
    "certificate expiring": (certificate(begins=WALL - 25 * DAY, ends=WALL + 5 * DAY), "certificate-expires",
        "c.pem expires on 2027-01-20 08:00 UTC, in 5 days"),
    "certificate expired": (certificate(ends=WALL - 60.0), "certificate-expired",
        "c.pem has expired on 2027-01-15 07:59 UTC"),
    "certificate not yet valid": (certificate(begins=WALL + 7200.0), "certificate-not-yet-valid",
        "becomes valid in 2.0 hours"),
    "certificate of another robot": (certificate(name="robot2"), "certificate-name",
        "is the certificate of 'robot2', not of 'robot1'"),
    "certificate of wrong key": (certificate(problem="the key does not belong to it"), "certificate-unusable",
        "c.pem: the key does not belong"),
    "key readable by others": (certificate(mode=0o644), "key-readable", "readable by others (mode 644)"),
    "other mission installed": ({"installed_differs": "/opt/m.toml"}, "mission-differs",
        "in /opt/m.toml is not the one"),
}  # fmt: skip


@pytest.mark.parametrize("problem", PROBLEMS)
def test_each_problem_gives_only_its_finding(problem: str) -> None:
    changes, name, sentence = PROBLEMS[problem]
    sentences = found(replace(HEALTHY, **changes))
    assert list(sentences) == [name]
    assert sentence in sentences[name]


def test_single_pause_and_group_readable_key_are_accepted() -> None:
    assert found(replace(HEALTHY, odometry=paused(0.2), **certificate(mode=0o640))) == {}


def test_odometry_frame_matters_only_for_world_frame_missions() -> None:
    def with_frame(frame: str) -> Facts:
        spec = TB3.robots["robot1"].model_copy(update={"odometry_frame": frame})
        mission = TB3.model_copy(update={"robots": {**TB3.robots, "robot1": spec}})
        return replace(HEALTHY, mission=mission, odometry=stream(frames=("robot1/odom",)))

    assert list(found(with_frame("world"))) == ["odometry-frame"]
    assert found(with_frame("start")) == {}


def test_finding_for_rmw_zenoh_robot_does_not_name_bridge() -> None:
    data = TB3.model_dump()
    data["robots"]["robot1"]["ros"] = "rmw_zenoh"
    native = replace(HEALTHY, mission=Mission.model_validate(data), routed=False, subscribers=())
    (finding,) = [one for one in ROBOT_LINK.findings(native) if one.name == "route-lost"]
    assert "bridge" not in finding.sentence + finding.remedy


@pytest.mark.parametrize(("ros", "unit"), [("ros2dds", "zenoh-bridge-ros2dds"), ("rmw_zenoh", "rmw-zenohd")])
def test_missing_router_names_the_unit_of_the_mission(ros: str, unit: str) -> None:
    data = TB3.model_dump()
    data["robots"]["robot1"]["ros"] = ros
    facts = replace(HEALTHY, mission=Mission.model_validate(data), router_error="silent", routed=None)
    (finding,) = [one for one in ROBOT_LINK.findings(facts) if one.name == "router-missing"]
    assert finding.remedy == f"sudo systemctl restart {unit}; its log: journalctl -u {unit}"


def test_unreachable_agent_is_not_also_reported_silent() -> None:
    nothing = replace(DESK, status=Stream(), newest_status=None)
    assert list(found(nothing)) == ["agent-silent"]
    refused = replace(nothing, reached={"robot1": Reached("tls/h:1", "refused")})
    assert list(found(refused)) == ["unreachable"]
    reported = replace(DESK, newest_status=status_of(link=RobotLink.NO_LISTENER))
    assert list(found(reported)) == ["route-lost"]


PATROL = load("patrol")
OWN = LeaderStatus(
    robot="deputy",
    state=LeaderState.STANDBY,
    reason=Reason.of(Code.OTHER_LEADS, robot="leader"),
    mission=PATROL.fingerprint,
)
STANDBY = replace(
    DESK,
    mission=PATROL,
    robot="deputy",
    newest_status=OWN,
    reached={"deputy": Reached("tls/192.168.1.16:7460", "ok", name="deputy")},
    certificate=None,
)


def test_healthy_standby_has_no_findings() -> None:
    assert found(STANDBY) == {}
    seen = {checked.title: checked.seen for checked in examine(EXAMINATIONS, STANDBY)}
    assert seen["agent"] == "says standby: leader leads"
    assert seen["mission"] == "standby runs it"


def test_silent_or_unreachable_standby_is_named() -> None:
    silent = found(replace(STANDBY, status=Stream(), newest_status=None))
    assert silent == {"standby-silent": "its standby says nothing: no status in 3 s"}
    away = {"deputy": Reached("tls/h:1", "no answer")}
    lost = found(replace(STANDBY, status=Stream(), newest_status=None, reached=away))
    assert lost == {"unreachable": "the standby deputy at tls/h:1 does not answer"}
    robot = replace(HEALTHY, mission=PATROL, newest_status=None, status=None, reached=away)
    assert found(robot)["unreachable"] == "the standby deputy at tls/h:1 does not answer"


def test_neighbour_never_received_is_named() -> None:
    assert found(replace(HEALTHY, newest_status=status_of(age={"odometry": 0.012}))) == {
        "neighbour-silent": "its neighbour leader has never been received"
    }


def test_two_ages_tells_restart_from_two_agents_at_once() -> None:
    one_after_the_other = [*signs(50.0, end=1.0), (101.0, -1.0), *signs(-1.5, begin=1.5)]
    assert two_ages(one_after_the_other) is None
    assert two_ages(sorted(one_after_the_other + signs(20.0, begin=0.5))) is not None
    late = [(arrived + 0.3 * (k % 7 == 0), value) for k, (arrived, value) in enumerate(signs(50.0))]
    assert two_ages(late) is None


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        (
            "C0A8010A,192.168.1.10,3,1.7e9,-0.000012345,0.00001,0.00002,-1.2,0.0,0.1,0.01,0.001,16.0,Normal",
            Chrony(-0.000012345, synchronised=True),
        ),
        (
            "00000000,,0,0.0,0.0,0.0,0.0,0.0,0.0,0.0,1.0,1.0,0.0,Not synchronised",
            Chrony(0.0, synchronised=False),
        ),
        ("506 Cannot talk to daemon", None),
    ],
)
def test_read_tracking_parses_chrony_output(line: str, expected: Chrony | None) -> None:
    assert read_tracking(line) == expected


def test_report_in_80_columns_names_robot_sentence_and_remedy() -> None:
    unhealthy = replace(
        HEALTHY, routed=False, subscribers=(), installed_differs="/opt/formation/current/mission.toml"
    )
    result = words({"robot1": examine(EXAMINATIONS, unhealthy), "robot2": examine(EXAMINATIONS, HEALTHY)})
    lines = result.splitlines()
    assert max(map(len, lines)) <= 80
    assert "  ✗ robot        nothing listens to cmd_vel: the bridge has lost its route, or\n" in result
    assert "                 → restart the bring-up and the bridge together\n" in result
    assert (lines[0], lines[-1]) == ("robot1", "2 things are wrong: robot1")
    assert words({"robot2": examine(EXAMINATIONS, HEALTHY)}).endswith("\nhealthy: nothing is wrong")


class Terminal(io.StringIO):
    """A terminal that shows colours."""

    encoding = "utf-8"

    def isatty(self) -> bool:
        return True


def test_style_is_plain_with_no_color_set(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NO_COLOR", raising=False)
    assert style(Terminal()) == COLOUR
    for value, expected in (("", COLOUR), ("1", PLAIN)):
        monkeypatch.setenv("NO_COLOR", value)
        assert style(Terminal()) == expected


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["--prefix", "/nowhere"], "MISSION is missing, and none is installed here"),
        (["turtlebot3_pair", "--robot", "robot9"], "--robot 'robot9': must be a follower of turtlebot3-pair"),
        (["turtlebot3_pair", "--robot", "leader"], "--robot 'leader': must be a follower"),
        (["turtlebot3_pair", "--robot", "robot1", "--robot-connect", "there"], "'there': must be PROTOCOL/"),
        (["no_such_mission"], "no such file"),
        (["turtlebot3_pair", "-c", "/nowhere.json5"], "--config '/nowhere.json5'"),
    ],
)
def test_doctor_refuses_illegal_arguments_with_reason(words: list[str], why: str, capsys: Capsys) -> None:
    assert why in refused(capsys, ["doctor", *words])


@pytest.mark.parametrize(
    ("mission", "robot", "why"),
    [
        ("turtlebot3_pair", "robot1", "zenoh.json5 is missing: install this robot's bundle again"),
        ("patrol", "leader", "this is the leader's machine: give MISSION"),
        ("patrol", "deputy", "this is the standby's machine: give MISSION"),
    ],
)
def test_doctor_refuses_unsuitable_installation_with_reason(
    mission: str, robot: str, why: str, tmp_path: Path, capsys: Capsys
) -> None:
    home = tmp_path / "current"
    home.mkdir()
    (home / "mission.toml").write_bytes(shipped()[mission].read_bytes())
    (home / "VERSION.json").write_text(json.dumps({"robot": robot}))
    assert why in refused(capsys, ["doctor", "--prefix", str(tmp_path)])


class SilencedBus:
    """Delivers one status of robot1, then nothing, as its agent has died; also the clock."""

    def __init__(self) -> None:
        self.mono = 100.0
        payload = encode(to_message(status_of(), WALL))
        self.waiting = [Sample(STATUS.key("robot1"), payload, None, self.mono)]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None: ...

    def subscribe(self, _key: str) -> None: ...

    def wait(self, patience: float) -> None:
        self.mono += 0.0 if self.waiting else patience

    def drain(self) -> list[Sample]:
        drained, self.waiting = self.waiting, []
        return drained

    def monotonic(self) -> float:
        return self.mono

    def time(self) -> float:
        return WALL + self.mono


def test_agent_that_dies_while_doctor_listens_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    bus = SilencedBus()
    monkeypatch.setattr(gather, "Bus", lambda _config: bus)
    monkeypatch.setattr(gather, "time", bus)
    monkeypatch.setattr(gather, "dial", lambda end, _papers: Reached(end, "ok", name="robot1"))
    (facts,) = gather.fleet_facts(TB3, ["robot1"], 2.0, None, None, None)
    assert found(facts)["agent-silent"] == "its agent fell silent: newest status 2.0 s old; limit 1 s"
