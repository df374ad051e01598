"""What an agent makes of the link to its robot: not there, there without a listener, or only looked at."""

from __future__ import annotations

import pytest

from agent.alive import FAREWELL
from agent.core import Agent
from agent.status import Surroundings
from formation.mission_file import load
from formation.order import Order, Told
from formation.order import encode as encode_order
from formation.ros2.messages import Diagnostics, Number, Odometry, Pose, TwistStamped, decode, encode
from formation.topics import ALIVE, CMD_VEL, ODOM, POSITION, STATUS, TABLE
from formation.unicycle import Command, advance
from formation.wire import Now, Outgoing, Sample
from tests.agent.fleet import EPOCH, Fleet
from tests.agent.missions import with_robots

PAIR = with_robots("turtlebot3_pair", speed_step=0.01, turn_rate_step=0.01)
SIX = load("six_robots")
AT_REST = (0.0, 0.0)
LOST = Surroundings(connected=True, routed=False)
FINE = Surroundings(connected=True, routed=True)


def status(outbox: list[Outgoing], name: str) -> Diagnostics:
    (one,) = [out for out in outbox if out.key == STATUS.key(name)]
    return decode(Diagnostics, one.payload)


@pytest.mark.parametrize(
    ("surroundings", "reason", "link"),
    [
        (LOST, "the robot does not listen to cmd_vel", "no listener on cmd_vel: the bridge's route is lost"),
        (Surroundings(connected=False), "no link to the robot", "not connected"),
    ],
)
def test_a_robot_that_does_not_hear_is_sent_zero_and_the_reason_is_in_its_status(
    surroundings: Surroundings, reason: str, link: str
) -> None:
    fleet = Fleet(PAIR)
    fleet.run(3.0)
    agent = fleet.agents["robot1"]
    integral = agent._integral
    agent.aware(surroundings)
    fleet.run(2.0)
    assert {command[1:] for command in fleet.commands["robot1"] if command[0] > 3.06} == {AT_REST}
    said = fleet._said["robot1"].statuses[0]
    assert said.level == 1
    assert said.values["reason"] == reason
    assert said.values["robot link"] == link
    assert link in said.message
    assert agent._integral == integral
    agent.aware(FINE)
    fleet.run(20.0)
    assert fleet.status("robot1")["robot link"] == "connected"
    assert fleet.error() < 0.03


def test_a_link_of_which_nobody_knows_is_not_spoken_of() -> None:
    fleet = Fleet(SIX)
    fleet.run(1.0)
    assert "robot link" not in fleet.status("robot2")


def test_refusals_are_counted_by_kind_in_the_status() -> None:
    fleet = Fleet(SIX)
    refused = {"put robot3/position": 12, "certificate: unknown issuer": 3}
    fleet.agents["robot2"].aware(Surroundings(True, True, refused))
    fleet.run(1.0)
    said = fleet.status("robot2")
    assert said["refused put robot3/position"] == "12"
    assert said["refused certificate: unknown issuer"] == "3"


class Moored(Fleet):
    """A fleet whose robot1 is only looked at: nobody passes on what its agent commands."""

    def new_agent(self, name: str) -> Agent:
        return Agent(self.mission, name, self.law, readonly=name == "robot1", voice=name)


@pytest.mark.parametrize("source", ["odometry", "external"])
def test_readonly_says_what_it_would_do_and_winds_nothing_up_while_nothing_moves(source: str) -> None:
    fleet = Moored(with_robots("turtlebot3_pair", localisation=source, speed_step=0.01, turn_rate_step=0.01))
    fleet.meddle = lambda sample: () if sample.key == CMD_VEL.key("robot1") else (sample,)
    agent = fleet.agents["robot1"]
    agent.aware(LOST)  # nothing is published there, so nobody can be seen to listen
    fleet.run(10.0)
    said = fleet.status("robot1")
    assert fleet._said["robot1"].statuses[0].level == 1
    assert said["state"] == "readonly: would run"
    assert said["reason"] == "in formation control"
    assert fleet.last_command("robot1") != AT_REST
    assert fleet.plant("robot1").path == 0.0
    start = fleet.mission.first_heading("robot1")
    assert agent._here.heading == pytest.approx(start, abs=0.01)  # nothing was learned from going nowhere
    assert all(abs(left) <= 0.01 for left in agent._commander.remainder)


@pytest.mark.parametrize("law", ["field", "paper"])
def test_the_integral_of_a_readonly_agent_stays_zero_however_far_the_leader_goes(law: str) -> None:
    fleet, driven = Moored(PAIR, law=law), Fleet(PAIR, law=law)
    fleet.meddle = lambda sample: () if sample.key == CMD_VEL.key("robot1") else (sample,)
    for one in (fleet, driven):
        one.run(10.0)
    assert driven.agents["robot1"]._integral != 0j
    assert fleet.agents["robot1"]._integral == 0j


def test_a_readonly_agent_that_would_not_run_says_so() -> None:
    agent = Agent(PAIR, "robot1", readonly=True)
    values = status(agent.step(Now(1.0, EPOCH), []), "robot1").statuses[0].values
    assert values["state"] == "readonly: would waiting"


def test_each_command_goes_first_and_with_it_a_sign_of_life() -> None:
    agent = Agent(PAIR, "robot1", voice="v")
    alive: list[float] = []
    position, heading, moving = -0.9 + 0.6j, 1 + 0j, Command(0.0, 0.0)
    for step in range(40):
        position, heading = advance(position, heading, *moving, 0.05)
        now = Now(7.0 + 0.05 * step, EPOCH + 0.05 * step)
        said = Order(term=1, beat=step, mode="run", shape="triangle")
        told = Told(voice="l", count=step, order=said, mission=PAIR.tag)
        leader = encode(Pose(now.wall, 0.0025 * step, 1 + 0j))
        odometry = encode(Odometry(now.wall, position, heading, *moving))
        inbox = [
            Sample(POSITION.key("leader"), leader, encode_order(told), now.mono),
            Sample(ODOM.key("robot1"), odometry, None, now.mono),
        ]
        outbox = agent.step(now, inbox)
        assert [out.key for out in outbox[:2]] == [CMD_VEL.key("robot1"), ALIVE.key("robot1")]
        twist = decode(TwistStamped, outbox[0].payload)
        moving = Command(twist.speed, twist.turn_rate)
        alive.append(decode(Number, outbox[1].payload).value)
    assert agent.decision.state == "run"
    assert alive == pytest.approx([0.05 * step for step in range(40)], abs=1e-9)


def test_a_robot_at_rest_has_an_agent_that_is_alive() -> None:
    agent = Agent(PAIR, "robot1")
    for step in range(10):
        outbox = agent.step(Now(0.06 * step, EPOCH + 0.06 * step), [])
        assert [out.key for out in outbox[:2]] == [CMD_VEL.key("robot1"), ALIVE.key("robot1")]


def test_an_agent_that_ends_takes_its_leave_of_its_guard_after_zero_velocity() -> None:
    agent = Agent(PAIR, "robot1")
    command, leave, said = agent.halt(Now(1.0, EPOCH), "SIGTERM")
    assert decode(TwistStamped, command.payload).speed == 0.0
    assert leave.key == ALIVE.key("robot1")
    assert decode(Number, leave.payload).value == FAREWELL
    assert said.key == STATUS.key("robot1")


def test_an_agent_publishes_its_commands_its_life_its_position_and_its_status_and_nothing_else() -> None:
    published = dict(Agent(PAIR, "robot1").publications)
    assert {topic.name for topic in published} == {"cmd_vel", "alive", "position", "status"}
    assert ALIVE in TABLE
