"""What an agent makes of the link to its robot: not there, there without a listener, or only looked at."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from formation.agent.core import Agent
from formation.agent.safety.commander import FAREWELL
from formation.agent.status import Surroundings
from formation.control.laws import LAWS
from formation.mission.file import load
from formation.protocol import order
from formation.protocol.order import OperatorReply
from formation.protocol.reasons import Code, Reason
from formation.protocol.status import AgentState, RobotLink
from formation.protocol.status_codec import LINKS
from formation.ros2.messages import Diagnostics, Number, TwistStamped, decode
from formation.topics import ALIVE, CMD_VEL, STATUS, TABLE
from formation.wire import Now, Outgoing, Sample
from tests.support.fleet import Fleet, at
from tests.support.meddling import lost
from tests.support.missions import with_robots

PAIR = with_robots("turtlebot3_pair", speed_step=0.01, turn_rate_step=0.01)
SIX = load("six_robots")
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


def test_unknown_link_is_not_reported() -> None:
    fleet = Fleet(SIX).after(1.0)
    assert fleet.status("robot2").link is RobotLink.UNKNOWN
    assert "link" not in fleet.message("robot2")


def test_refusals_are_counted_by_kind_in_the_status() -> None:
    fleet = Fleet(SIX)
    refused = {"put robot3/position": 12, "certificate: unknown issuer": 3}
    fleet.agents["robot2"].aware(Surroundings(True, True, refused))
    fleet.run(1.0)
    result = fleet.status("robot2")
    assert result.refused == refused


class Moored(Fleet):
    """A fleet whose robot1 is only looked at: nobody passes on what its agent commands."""

    def new_agent(self, name: str) -> Agent:
        return Agent(self.mission, name, self.law, readonly=name == "robot1", publisher_id=name)


@pytest.mark.parametrize("source", ["odometry", "external"])
def test_readonly_agent_reports_commands_without_windup(source: str) -> None:
    fleet = Moored(with_robots("turtlebot3_pair", localisation=source, speed_step=0.01, turn_rate_step=0.01))
    fleet.meddle = lost(CMD_VEL.key("robot1"))
    agent = fleet.agents["robot1"]
    agent.aware(LOST)  # nothing is published there, so nobody can be seen to listen
    fleet.run(10.0)
    result = fleet.status("robot1")
    assert fleet.reported("robot1").level == 1
    assert (result.state, result.readonly) == (AgentState.RUN, True)
    assert result.reason == Reason(Code.RUNNING)
    assert fleet.message("robot1").startswith("readonly: would run: ")
    assert fleet.last_command("robot1") != AT_REST
    assert fleet.plant("robot1").path == 0.0
    start = fleet.mission.first_heading("robot1")
    assert agent.here.heading == pytest.approx(start, abs=0.01)  # nothing was learned from going nowhere
    assert all(abs(left) <= 0.01 for left in agent.commander.state.remainder)


@pytest.mark.parametrize("law", [name for name, one in LAWS.items() if one.integral])
def test_readonly_integral_stays_zero(law: str) -> None:
    fleet, driven = Moored(PAIR, law=law), Fleet(PAIR, law=law)
    fleet.meddle = lost(CMD_VEL.key("robot1"))
    for one in (fleet, driven):
        one.run(10.0)
    assert driven.agents["robot1"].state.integral != 0j
    assert fleet.agents["robot1"].state.integral == 0j


@pytest.mark.parametrize("readonly", [True, False])
def test_answers_tell_readonly_agents_apart(*, readonly: bool) -> None:
    agent = Agent(PAIR, "robot1", readonly=readonly)
    for request in (b'{"do":"query"}', b'{"do":"run"}', b'{"do":"stop"}', b"junk"):
        assert order.decode(OperatorReply, agent.request(request, 0.0)).readonly is readonly


def test_a_readonly_agent_that_would_not_run_says_so() -> None:
    agent = Agent(PAIR, "robot1", readonly=True)
    (said,) = [out for out in agent.step(at(1.0), []) if out.key == STATUS.key("robot1")]
    result = decode(Diagnostics, said.payload).statuses[0]
    assert (result.values["state"], result.values["readonly"]) == ("waiting", "true")


def test_each_command_goes_first_and_with_it_a_sign_of_life(monkeypatch: pytest.MonkeyPatch) -> None:
    fleet = Fleet(PAIR)
    step, alive = fleet.agents["robot1"].step, list[tuple[float, float]]()

    def stepped(now: Now, inbox: Sequence[Sample]) -> list[Outgoing]:
        outbox = list(step(now, inbox))
        if any(out.key == CMD_VEL.key("robot1") for out in outbox):
            assert [out.key for out in outbox[:2]] == [CMD_VEL.key("robot1"), ALIVE.key("robot1")]
            alive.append((now.mono, decode(Number, outbox[1].payload).value))
        return outbox

    monkeypatch.setattr(fleet.agents["robot1"], "step", stepped)
    fleet.run(3.0)
    assert len(alive) > 50
    assert [value for _, value in alive] == pytest.approx([at - alive[0][0] for at, _ in alive])


def test_halting_agent_sends_zero_then_farewell_then_status() -> None:
    agent = Agent(PAIR, "robot1")
    command, leave, result = agent.halt(at(1.0), "SIGTERM")
    assert decode(TwistStamped, command.payload).speed == 0.0
    assert leave.key == ALIVE.key("robot1")
    assert decode(Number, leave.payload).value == FAREWELL
    assert result.key == STATUS.key("robot1")


def test_agent_publishes_only_command_life_position_and_status() -> None:
    published = dict(Agent(PAIR, "robot1").publications)
    assert {topic.name for topic in published} == {"cmd_vel", "alive", "position", "status"}
    assert ALIVE in TABLE
