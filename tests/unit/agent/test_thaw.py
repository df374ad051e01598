"""A process that was frozen knows nothing when it wakes: its first command is zero."""

from __future__ import annotations

import pytest

from formation.agent.inbox import DRAIN_TIME
from formation.agent.watchdog.core import Watchdog
from formation.mission.file import load
from formation.protocol.reasons import Code
from formation.protocol.status import AgentState, WatchdogState
from formation.ros2.messages import Number, encode
from formation.topics import ALIVE
from formation.wire import Now, Outgoing, Sample
from tests.support.fleet import EPOCH, Fleet

SIX = load("six_robots")
AT_REST = (0.0, 0.0)
KEY = ALIVE.key("robot2")


@pytest.mark.parametrize("leader_dies", [False, True])
def test_a_thawed_agent_begins_with_zero(leader_dies: bool) -> None:
    fleet = Fleet(SIX)
    fleet.run(8.0)
    fleet.freeze("robot4")
    fleet.run(5.0)
    if leader_dies:
        fleet.kill("leader")
        fleet.run(0.3)
    woke = fleet.now
    fleet.thaw("robot4")
    fleet.run(DRAIN_TIME)
    assert set(fleet.commands_since("robot4", woke - 1e-9)) == {AT_REST}
    assert fleet.agents["robot4"].decision.reason.code is Code.PROCESS_FROZEN
    fleet.run(2.0)
    state = fleet.agents["robot4"].decision.state
    assert (state is AgentState.RUN) is not leader_dies


def test_messages_that_waited_are_dropped_and_counted() -> None:
    fleet = Fleet(SIX)
    fleet.run(8.0)
    fleet.freeze("robot4")
    fleet.run(3.0)
    fleet.thaw("robot4")
    fleet.run(0.1)
    assert any("waited while" in why for why in fleet.agents["robot4"].inbox.state.last_dropped.values())


def test_a_short_pause_is_no_freeze() -> None:
    fleet = Fleet(SIX)
    fleet.run(8.0)
    fleet.freeze("robot4")
    fleet.run(0.8)
    fleet.thaw("robot4")
    fleet.run(0.3)
    assert fleet.agents["robot4"].decision.state is AgentState.RUN


def signs(begin: float, end: float, arrived: float | None = None) -> list[Sample]:
    """Signs of life that an agent gave from `begin` to `end` [s], which arrive then or all at `arrived`."""
    count = round((end - begin) / 0.05)
    moments = [begin + 0.05 * number for number in range(count)]
    return [
        Sample(KEY, encode(Number(moment)), None, moment if arrived is None else arrived)
        for moment in moments
    ]


def lived(watchdog: Watchdog, begin: float, end: float) -> None:
    for sample in signs(begin, end):
        watchdog.step(Now(sample.arrived, EPOCH + sample.arrived), [sample])


def test_a_thawed_watchdog_does_not_believe_signs_of_life_that_waited() -> None:
    watchdog = Watchdog(SIX, "robot2")
    watchdog.aware(connected=True, now=Now(0.0, EPOCH))
    lived(watchdog, 0.0, 5.0)
    waited = signs(5.0, 6.0, arrived=15.0)  # the agent died at 6.0
    assert watchdog.step(Now(15.0, EPOCH + 15.0), waited[:10]) == []
    assert watchdog.state.value == "listening"
    outbox: list[Outgoing] = watchdog.step(Now(15.16, EPOCH + 15.16), waited[10:])
    assert watchdog.state.value == "parking"
    assert len(outbox) == 1


def test_a_thawed_watchdog_leaves_a_healthy_agent_alone() -> None:
    watchdog = Watchdog(SIX, "robot2")
    watchdog.aware(connected=True, now=Now(0.0, EPOCH))
    lived(watchdog, 0.0, 5.0)
    assert watchdog.step(Now(15.0, EPOCH + 15.0), signs(5.0, 7.0, arrived=15.0)) == []
    fresh = Sample(KEY, encode(Number(15.02)), None, 15.03)
    assert watchdog.step(Now(15.03, EPOCH + 15.03), [fresh]) == []
    assert watchdog.state is WatchdogState.WATCHING
