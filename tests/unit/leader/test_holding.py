"""A leader that was started to hold waits for ``run``, unless the team is under way."""

from __future__ import annotations

import pytest

from formation.leader.core import Leader
from formation.mission.file import load, parse
from formation.mission.model import Mission
from formation.protocol.election import TERM_EXPIRY_TIME
from formation.protocol.order import Order
from formation.protocol.status import AgentState
from tests.support.fleet import Fleet
from tests.unit.leader.leading import CURVED, arriving, ask, at, drive, positions, relayed

TERM = int(1.6e9 * 1e9)
RUNNING = Order(term=TERM, beat=90, mode="run", shape="near", time=2.0)
PAIR = load("turtlebot3_pair")
TWO = parse(
    CURVED.replace("bob = [-1.0, 0.0]", "bob = [-1.0, 0.0]\neve = [-2.0, 0.0]").replace(
        "bob = [-0.5, 0.0]", "bob = [-0.5, 0.0]\neve = [-1.5, 0.0]"
    )
    + '[robots.eve]\nneighbours = ["ann"]\nstart = { x = 0.0, y = 1.0 }\n'
)


@pytest.fixture
def mission() -> Mission:
    return parse(CURVED)


def begun(of: Mission, *told: tuple[str, Order, bool], hold: bool = True) -> Leader:
    """A leader that has heard these robots, what they relay and whether that is stale."""
    leader = Leader(of, hold=hold)
    leader.step(at(0.0), [])
    for robot, what, stale in told:
        leader.step(at(0.1), [arriving(relayed(robot, what, of=of, stale=stale), 0.1)])
    if not leader.leads:
        leader.step(at(1.1), [])
    return leader


@pytest.mark.parametrize(
    ("stale", "hold", "mode"), [(True, True, "hold"), (True, False, "run"), (False, True, "run")]
)
def test_hold_waits_after_an_outage(mission: Mission, *, stale: bool, hold: bool, mode: str) -> None:
    leader = begun(mission, ("bob", RUNNING, stale), hold=hold)
    assert (leader.mode, leader.plan.shape_transition.wish.shape) == (mode, "near")
    assert leader.route_time == pytest.approx(2.0, abs=0.01)
    assert ask(leader, b'{"do":"run"}').mode == "run"


@pytest.mark.parametrize("order", [("bob", "eve"), ("eve", "bob")])
def test_one_robot_that_knows_of_an_outage_is_enough(order: tuple[str, str]) -> None:
    told = {"bob": ("bob", RUNNING, True), "eve": ("eve", RUNNING, False)}
    assert begun(TWO, *(told[name] for name in order)).mode == "hold"


@pytest.mark.parametrize("order", [("bob", "eve"), ("eve", "bob")])
def test_robot_cut_off_before_is_no_outage(order: tuple[str, str]) -> None:
    """It relays an earlier beat than the others."""
    old = RUNNING.model_copy(update={"beat": 40})
    told = {"bob": ("bob", old, True), "eve": ("eve", RUNNING, False)}
    assert begun(TWO, *(told[name] for name in order)).mode == "run"


@pytest.mark.parametrize(("stale", "mode"), [(True, "hold"), (False, "run")])
def test_hold_after_listening_depends_on_outage_too(mission: Mission, *, stale: bool, mode: str) -> None:
    leader = begun(mission)
    assert leader.mode == "hold"
    leader.step(at(2.0), [arriving(relayed("bob", RUNNING, of=mission, stale=stale), 2.0)])
    assert (leader.mode, leader.plan.shape_transition.wish.shape) == (mode, "near")


def test_stop_and_hold_survive_an_outage(mission: Mission) -> None:
    rest = RUNNING.model_copy(update={"mode": "stop", "holding": True})
    leader = begun(mission, ("bob", rest, True))
    assert leader.mode == "stop"
    assert ask(leader, b'{"do":"release"}').mode == "hold"


def test_standby_started_to_hold_remembers_no_run_for_long() -> None:
    """Its robots were switched off and on, and relay nothing; it has been on all the while."""
    stood = parse(CURVED.replace("[shapes.line]", "[standbys.cat]\n[shapes.line]"))
    for wait, under_way in ((0.5 * TERM_EXPIRY_TIME, True), (2.0 * TERM_EXPIRY_TIME, False)):
        standby = Leader(stood, "cat", hold=True)
        for k in range(2):
            what = RUNNING.model_copy(update={"beat": 90 + k})
            standby.step(at(0.1 * k), [arriving(relayed("bob", what, of=stood), 0.1 * k)])
        assert standby._under_way(at(0.1 + wait)) is under_way


@pytest.mark.parametrize(("seconds", "mode"), [(2.0, "run"), (TERM_EXPIRY_TIME + 1.0, "hold")])
def test_real_team_sets_off_again_only_after_run(seconds: float, mode: str) -> None:
    fleet = Fleet(PAIR, seed=1)
    fleet.run(4.0)
    fleet.kill("leader")
    fleet.run(seconds)
    fleet.restart("leader")
    leader = Leader(PAIR, hold=True, publisher_id="another")
    fleet.nodes["leader"].core = fleet.candidates["leader"] = fleet.leader = leader
    fleet.run(3.0)
    assert leader.mode == mode
    assert {agent.decision.state for agent in fleet.agents.values()} == {AgentState(mode)}
    assert fleet.ask("leader", "run").ok
    fleet.run(1.0)
    assert {agent.decision.state for agent in fleet.agents.values()} == {AgentState.RUN}


def test_ended_leader_leaves_a_hold(mission: Mission) -> None:
    leader = begun(mission, hold=False)
    drive(leader, 1.14, 1.0)
    (last,) = positions(3.0, leader.halt(at(3.0), "SIGINT"))
    assert begun(mission, ("bob", last.order, False), hold=False).mode == "hold"
