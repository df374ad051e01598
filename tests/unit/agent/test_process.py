"""Messages that an agent's loop sends to fleet and robot, and its handling of the link to the robot."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from types import SimpleNamespace
from typing import Any, cast

import pytest

from formation.agent.core import Agent
from formation.agent.persistence.persistence import Persistence
from formation.agent.persistence.store import Store
from formation.agent.process import REFUSED_PERIOD, Sides
from formation.agent.safety.commander import FAREWELL
from formation.agent.status import Surroundings
from formation.control.laws import LAWS
from formation.mission.file import load
from formation.mission.model import Mission
from formation.protocol import json_message
from formation.protocol.reasons import Code, Reason
from formation.protocol.request import OperatorReply
from formation.protocol.status import AgentState, RobotLink
from formation.protocol.status_codec import LINKS
from formation.ros2.messages import Number, Odometry, TwistStamped, decode, encode
from formation.topics import ALIVE, CMD_VEL, STATUS, Topic
from formation.wire import BadMessage, Now, Outgoing, Sample
from tests.support.fleet import Fleet, at
from tests.support.meddling import lost
from tests.support.missions import with_robots
from tests.support.restarting import Drawer

SIX = load("six_robots")
ODOMETRY = Sample("robot2/odom", encode(Odometry(100.0, 0j, 1 + 0j, 0.0, 0.0)), b"33 bytes of ROS's", 1.0)
SEEN = Sample("robot2/scan", b"\x00\x01\x00\x00 a scan", None, 1.0)


class Wire:
    """Stands in for the connection to one side; records all calls."""

    def __init__(self, side: str, log: list[tuple[str, str, bytes | None]]) -> None:
        self.advertised, self.subscribed = list[str](), list[str]()
        self.waiting = set[str]()
        """Keys of messages that do not wake the agent."""
        self.connected, self.listens, self.requested = True, True, 0
        self._side, self._log = side, log

    def advertise(self, _topic: Topic, key: str) -> None:
        self.advertised.append(key)

    def subscribe(self, *where: Any, wakes: bool = True, from_others: bool = False, **_how: Any) -> None:
        self.subscribed.append(where[-1])
        if from_others or not wakes:
            self.waiting.add(where[-1])

    def publish(self, key: str, payload: bytes, attachment: bytes | None = None) -> None:
        assert key in self.advertised
        assert payload
        self._log.append((self._side, key, attachment))

    def routed(self, key: str) -> bool | None:
        assert key == "robot2/cmd_vel"
        return self.listens if self.connected else None

    @property
    def refused(self) -> Counter[str]:
        self.requested += 1
        return Counter({"put robot3/position": 2})


class Setting:
    """An agent's loop between two such connections."""

    def __init__(self, mission: Mission = SIX, *, readonly: bool = False) -> None:
        self.log: list[tuple[str, str, bytes | None]] = []
        self.fleet, self.robot = Wire("fleet", self.log), Wire("robot", self.log)
        self.agent = Agent(mission, "robot2", readonly=readonly, publisher_id="v")
        process: Any = SimpleNamespace(
            bus=self.fleet, robot=self.robot, clock=lambda: Now(1.2, 100.2), let_threads_run=lambda: None
        )
        self.process = process
        self.sides = Sides(self.agent, process)
        self.sides.declare()

    def turn(self, *inbox: Sample, mono: float = 1.0) -> list[tuple[str, str]]:
        """One turn of the loop: side and key of everything sent, in order."""
        self.log.clear()
        self.sides.send(self.sides.step(Now(mono, 99.0 + mono), inbox))
        return [(side, key) for side, key, _ in self.log]


@pytest.fixture
def setting() -> Setting:
    return Setting()


def test_command_is_sent_first_and_inputs_repeated_last(setting: Setting) -> None:
    assert setting.turn(ODOMETRY) == [
        ("robot", "robot2/cmd_vel"),
        ("robot", "robot2/alive"),
        ("fleet", "robot2/position"),
        ("fleet", "robot2/status"),
        ("fleet", "robot2/cmd_vel"),
        ("robot", "robot2/position"),
        ("robot", "robot2/status"),
        ("fleet", "robot2/odom"),
    ]


def test_command_is_sent_before_later_messages_are_computed(setting: Setting) -> None:

    def outbox() -> Iterator[Outgoing]:
        yield Outgoing("robot2/cmd_vel", b"command")
        assert [key for _, key, _ in setting.log] == ["robot2/cmd_vel"]
        yield Outgoing("robot2/position", b"position", b"order")
        assert [key for _, key, _ in setting.log] == ["robot2/cmd_vel"]  # the rest is sent together

    setting.sides.send(outbox())
    assert len(setting.log) == 4


def test_attachments_are_sent_to_the_fleet_only(setting: Setting) -> None:
    setting.turn(ODOMETRY)
    attachments = {(side, key): attachment for side, key, attachment in setting.log}
    assert {attachment for (side, _), attachment in attachments.items() if side == "robot"} == {None}
    assert attachments["fleet", "robot2/position"] is not None
    assert attachments["fleet", "robot2/cmd_vel"] is not None
    assert attachments["fleet", "robot2/odom"] is None


def test_sign_of_second_agent_counts_for_one_second(setting: Setting) -> None:
    assert "robot2/alive" in setting.robot.waiting  # signs of life do not wake the agent
    sign = Sample("robot2/alive", encode(Number(12.0)), None, 1.0)
    setting.turn(ODOMETRY, sign)
    assert setting.agent.decision.reason.code is Code.SECOND_AGENT
    setting.turn(mono=1.9)
    assert setting.agent.decision.reason.code is Code.SECOND_AGENT
    setting.turn(mono=2.1)
    assert setting.agent.decision.reason.code is not Code.SECOND_AGENT


@pytest.mark.parametrize(("value", "readonly"), [(FAREWELL, False), (12.0, True)])
def test_farewell_or_readonly_makes_no_second_agent(value: float, *, readonly: bool) -> None:
    setting = Setting(readonly=readonly)
    setting.turn(ODOMETRY, Sample("robot2/alive", encode(Number(value)), None, 1.0))
    assert setting.agent.decision.reason.code is not Code.SECOND_AGENT


def test_readonly_agent_sends_robot_only_position_and_status() -> None:
    setting = Setting(readonly=True)
    result = setting.turn(ODOMETRY)
    assert {key for side, key in result if side == "robot"} == {"robot2/position", "robot2/status"}
    assert ("fleet", "robot2/cmd_vel") in result
    setting.log.clear()
    setting.sides.send(setting.sides.halt(Now(2.0, 101.0), "SIGTERM"))
    assert {key for side, key, _ in setting.log if side == "robot"} == {"robot2/status"}


def test_neighbour_positions_come_from_fleet_and_are_not_repeated(setting: Setting) -> None:
    others = ["robot1/position"]
    assert setting.fleet.subscribed == others
    assert setting.robot.subscribed == ["robot2/odom", "robot2/scan", "robot2/alive"]
    assert setting.fleet.waiting == set(others), "only the robot's own messages wake its agent"
    assert setting.robot.waiting == {"robot2/alive"}
    assert "robot2/alive" in setting.robot.advertised
    assert "robot2/alive" not in setting.fleet.advertised
    position = Sample("robot1/position", b"anything", None, 1.0)
    assert ("fleet", "robot1/position") not in setting.turn(position)


def test_displacements_come_from_robot_side_and_are_repeated() -> None:
    setting = Setting(with_robots("six_robots", measurement="local"))
    assert "robot2/relative/robot1" in setting.robot.subscribed
    seen = Sample("robot2/relative/robot1", b"\x00\x01\x00\x00 seen", None, 1.0)
    assert ("fleet", "robot2/relative/robot1") in setting.turn(seen)


@pytest.mark.parametrize("received", [(ODOMETRY,), (ODOMETRY, SEEN), (SEEN, ODOMETRY, SEEN)])
def test_received_messages_are_repeated_once_and_in_order(
    setting: Setting, received: Sequence[Sample]
) -> None:
    repeated = [key for _, key in setting.turn(*received)][-len(received) :]
    assert repeated == [sample.key for sample in received]
    assert not {"robot2/odom", "robot2/scan"} & {key for _, key in setting.turn(mono=1.01)}
    assert setting.sides.dropped == {}


def test_agent_uses_link_state_of_previous_step(setting: Setting, monkeypatch: pytest.MonkeyPatch) -> None:
    result = list[Surroundings]()
    monkeypatch.setattr(setting.agent, "aware", result.append)
    for connected, listens in ((True, False), (False, False), (True, True), (True, True)):
        setting.robot.connected, setting.robot.listens = connected, listens
        setting.turn()
    links = [(one.connected, one.routed) for one in result]
    assert links == [(True, True), (True, False), (False, None), (True, True)]


def test_command_is_sent_before_link_is_checked(setting: Setting, monkeypatch: pytest.MonkeyPatch) -> None:
    routed = setting.robot.routed

    def checked(key: str) -> bool | None:
        setting.log.append(("robot", "checked", None))
        return routed(key)

    monkeypatch.setattr(setting.robot, "routed", checked)
    assert setting.turn(ODOMETRY)[-1] == ("robot", "checked")


def test_refusals_are_queried_once_per_refused_period(
    setting: Setting, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = list[Surroundings]()
    monkeypatch.setattr(setting.agent, "aware", result.append)
    setting.turn()
    setting.turn(mono=1.01)
    assert {one.refused["put robot3/position"] for one in result} == {2}
    assert setting.fleet.requested == 1
    setting.turn(mono=1.0 + REFUSED_PERIOD)
    assert setting.fleet.requested == 2


def test_agent_with_failing_status_still_stops_its_robot(
    setting: Setting, monkeypatch: pytest.MonkeyPatch
) -> None:
    setting.turn(ODOMETRY)
    setting.log.clear()

    def fail(*_: Any) -> Outgoing:
        raise BadMessage("cannot be said")

    monkeypatch.setattr(setting.agent, "_status", fail)
    with pytest.raises(BadMessage):
        setting.sides.send(setting.sides.halt(Now(2.0, 101.0), "failed"))
    assert [key for side, key, _ in setting.log if side == "robot"] == ["robot2/cmd_vel", "robot2/alive"]


class Slow(Drawer):
    """A disk that never finishes writing; records what had been sent when the loop waited for it."""

    def __init__(self, log: list[tuple[str, str, bytes | None]]) -> None:
        super().__init__()
        self._log, self.before = log, list[tuple[str, str]]()

    def written(self, _patience: float) -> bool:
        self.before = [(side, key) for side, key, _ in self._log]
        return False


def use_disk(setting: Setting, disk: Drawer) -> None:
    """Have the agent store its state on this disk."""
    persistence = Persistence(setting.agent, cast("Store", disk), "a boot")
    setting.sides = Sides(setting.agent, setting.process, persistence=persistence)
    setting.sides.declare()


def test_stop_is_sent_before_it_is_stored(setting: Setting) -> None:
    disk = Slow(setting.log)
    use_disk(setting, disk)
    setting.sides.request(b'{"do":"hold"}', 1.1)
    assert disk.before == [], "an agent that has not begun sends nothing"
    setting.turn(ODOMETRY)
    setting.log.clear()
    assert b'"ok":true' in setting.sides.request(b'{"do":"stop"}', 1.1)
    assert disk.before[0] == ("robot", "robot2/cmd_vel")
    assert ("fleet", "robot2/status") not in disk.before, "the reply does not wait for the status"
    assert ("fleet", "robot2/status") in setting.turn(mono=1.2)
    assert setting.agent.decision.state is AgentState.STOP


def test_stop_is_stored_even_if_its_step_fails(setting: Setting, monkeypatch: pytest.MonkeyPatch) -> None:
    disk = Drawer()
    use_disk(setting, disk)
    setting.turn(ODOMETRY)

    def fail(*_: Any) -> None:
        raise ZeroDivisionError("of today")

    monkeypatch.setattr(setting.agent, "act", fail)
    with pytest.raises(ZeroDivisionError):
        setting.sides.request(b'{"do":"stop"}', 1.1)
    assert b'"mode": "stop"' in disk.texts["stops"]


PAIR = with_robots("turtlebot3_pair", speed_step=0.01, turn_rate_step=0.01)
AT_REST = (0.0, 0.0)
LOST = Surroundings(connected=True, routed=False)
FINE = Surroundings(connected=True, routed=True)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("surroundings", "reason", "link"),
    [
        (LOST, Code.NO_LISTENER, RobotLink.NO_LISTENER),
        (Surroundings(connected=False), Code.NO_LINK, RobotLink.NOT_CONNECTED),
    ],
)
def test_disconnected_robot_gets_zero_and_status_gives_reason(
    surroundings: Surroundings, reason: Code, link: RobotLink
) -> None:
    fleet = Fleet.under_way(PAIR, 3.0)
    agent = fleet.agents["robot1"]
    integral = agent.state.integral
    agent.aware(surroundings)
    fleet.run(2.0)
    assert set(fleet.commands_since("robot1", 3.06)) == {AT_REST}
    result = fleet.reported("robot1")
    assert result.level == 1
    assert fleet.status("robot1").reason == Reason(reason)
    assert fleet.status("robot1").link is link
    assert LINKS[link] in result.message
    assert agent.state.integral == integral
    agent.aware(FINE)
    fleet.run(20.0)
    assert fleet.status("robot1").link is RobotLink.CONNECTED
    assert fleet.error() < 0.03


def test_status_reports_refusals_by_kind_but_no_unknown_link() -> None:
    fleet = Fleet(SIX)
    refused = {"put robot3/position": 12, "certificate: unknown issuer": 3}
    fleet.agents["robot2"].aware(Surroundings(True, True, refused))
    fleet.run(1.0)
    assert fleet.status("robot2").refused == refused
    assert fleet.status("robot3").link is RobotLink.UNKNOWN
    assert "link" not in fleet.message("robot3")


class ReadonlyFleet(Fleet):
    """A fleet in which robot1's agent is readonly."""

    def new_agent(self, name: str) -> Agent:
        return Agent(self.mission, name, self.law, readonly=name == "robot1", publisher_id=name)


@pytest.mark.parametrize("source", ["odometry", "external"])
def test_readonly_agent_reports_commands_but_learns_nothing(source: str) -> None:
    fleet = ReadonlyFleet(
        with_robots("turtlebot3_pair", localisation=source, speed_step=0.01, turn_rate_step=0.01)
    )
    fleet.meddle = lost(CMD_VEL.key("robot1"))
    agent = fleet.agents["robot1"]
    agent.aware(LOST)  # no command is published, so no listener can be detected
    fleet.run(10.0)
    result = fleet.status("robot1")
    assert fleet.reported("robot1").level == 1
    assert (result.state, result.readonly) == (AgentState.RUN, True)
    assert result.reason == Reason(Code.RUNNING)
    assert fleet.message("robot1").startswith("readonly: would run: ")
    assert fleet.last_command("robot1") != AT_REST
    assert fleet.plant("robot1").path == 0.0
    start = fleet.mission.first_heading("robot1")
    assert agent.here.heading == pytest.approx(start, abs=0.01)  # standing does not change the estimate
    assert all(abs(left) <= 0.01 for left in agent.commander.state.remainder)


@pytest.mark.parametrize("law", [name for name, one in LAWS.items() if one.integral])
def test_readonly_integral_stays_zero(law: str) -> None:
    fleet, driven = ReadonlyFleet(PAIR, law=law), Fleet(PAIR, law=law)
    fleet.meddle = lost(CMD_VEL.key("robot1"))
    for one in (fleet, driven):
        one.run(10.0)
    assert driven.agents["robot1"].state.integral != 0j
    assert fleet.agents["robot1"].state.integral == 0j


@pytest.mark.parametrize("readonly", [True, False])
def test_replies_state_whether_agent_is_readonly(*, readonly: bool) -> None:
    agent = Agent(PAIR, "robot1", readonly=readonly)
    for request in (b'{"do":"query"}', b'{"do":"run"}', b'{"do":"stop"}', b"junk"):
        assert json_message.decode(OperatorReply, agent.request(request, 0.0)).readonly is readonly


def test_each_command_is_sent_first_with_sign_of_life() -> None:
    agent, alive = Agent(PAIR, "robot1"), list[float]()
    for mono in (1.0, 2.0, 2.7):
        command, life, *_ = agent.step(at(mono), [])
        assert (command.key, life.key) == (CMD_VEL.key("robot1"), ALIVE.key("robot1"))
        alive.append(decode(Number, life.payload).value)
    assert alive == pytest.approx([0.0, 1.0, 1.7])


def test_halting_agent_sends_zero_then_farewell_then_status() -> None:
    agent = Agent(PAIR, "robot1")
    command, leave, result = agent.halt(at(1.0), "SIGTERM")
    assert decode(TwistStamped, command.payload).speed == 0.0
    assert leave.key == ALIVE.key("robot1")
    assert decode(Number, leave.payload).value == FAREWELL
    assert result.key == STATUS.key("robot1")
