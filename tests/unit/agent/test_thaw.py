"""An agent that was frozen knows nothing when it wakes: its first command is zero."""

from __future__ import annotations

import pytest

from formation.agent.inbox import DRAIN_TIME
from formation.mission.file import load
from formation.protocol.reasons import Code
from formation.protocol.status import AgentState
from tests.support.fleet import Fleet

SIX = load("six_robots")
AT_REST = (0.0, 0.0)


@pytest.mark.parametrize("leader_dies", [False, True])
def test_a_thawed_agent_begins_with_zero(leader_dies: bool) -> None:
    fleet = Fleet.under_way(SIX, 8.0)
    fleet.freeze("robot4")
    fleet.run(2.5)
    if leader_dies:
        fleet.kill("leader")
        fleet.run(0.3)
    woke = fleet.now
    fleet.thaw("robot4")
    fleet.run(DRAIN_TIME)
    assert set(fleet.commands_since("robot4", woke - 1e-9)) == {AT_REST}
    assert fleet.agents["robot4"].decision.reason.code is Code.PROCESS_FROZEN
    assert any("waited while" in why for why in fleet.agents["robot4"].inbox.state.last_dropped.values())
    fleet.run(2.0)
    state = fleet.agents["robot4"].decision.state
    assert (state is AgentState.RUN) is not leader_dies


def test_a_short_pause_is_no_freeze() -> None:
    fleet = Fleet.under_way(SIX, 8.0)
    fleet.freeze("robot4")
    fleet.run(0.8)
    fleet.thaw("robot4")
    fleet.run(0.3)
    assert fleet.agents["robot4"].decision.state is AgentState.RUN
