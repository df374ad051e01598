"""Another shape while the team drives, or stands: production cores, a fake clock, a network in memory."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from formation.mission.file import load
from tests.support.fleet import Fleet
from tests.unit.agent.sudden import most_sudden

SIX = load("six_robots")
AT_REST = (0.0, 0.0)


def driving(seconds: float = 10.0, *, loss: float = 0.0) -> Fleet:
    return Fleet(SIX, loss=loss, seed=3).after(seconds)


@pytest.mark.slow
@pytest.mark.parametrize("loss", [0.0, 0.3])
def test_the_team_takes_another_shape_within_its_limits_and_goes_back(loss: float) -> None:
    fleet = driving(loss=loss)
    for shape in ("wedge", "hexagon"):
        assert fleet.order_shape(shape).ok
        fleet.run(0.5)
        assert fleet.error() > SIX.settled
        fleet.run(9.5)
        assert fleet.error() < SIX.settled
    assert fleet.within_limits


def test_all_robots_follow_a_new_shape_while_driving() -> None:
    fleet = driving()
    before = {name: len(fleet.commands[name]) for name in SIX.followers}
    fleet.order_shape("wedge")
    fleet.run(0.5)
    assert {agent.orders.newest.shape for agent in fleet.agents.values() if agent.orders.newest} == {"wedge"}
    for name in SIX.followers:
        assert all(command[1:] != AT_REST for command in fleet.commands[name][before[name] :])


@pytest.mark.slow
@pytest.mark.parametrize("rest", ["hold", "stop"])
def test_a_robot_at_rest_takes_the_shape_when_it_runs(rest: str) -> None:
    fleet = driving()
    requested = SIX.names if rest == "stop" else ("robot1",)
    for name in requested:
        assert fleet.ask(name, rest).ok
    fleet.run(1.0)
    before, where = {name: len(fleet.commands[name]) for name in SIX.followers}, fleet.points()
    assert fleet.order_shape("wedge").ok
    fleet.run(3.0)
    for name in SIX.followers:
        assert {command[1:] for command in fleet.commands[name][before[name] :]} == {AT_REST}
    assert fleet.points() == pytest.approx(where, abs=1e-3)
    since = fleet.now
    for name in requested:
        assert fleet.set_going(name).ok
    fleet.run(10.0)
    assert most_sudden(fleet, since, rests=True) < 0.5
    assert fleet.error() < SIX.settled
    assert fleet.within_limits


orders = st.one_of(
    st.sampled_from(["stop", "hold", "run", "release"]).map(lambda do: (do, None)),
    st.sampled_from(["hexagon", "wedge"]).map(lambda shape: ("shape", shape)),
)


@pytest.mark.slow
@settings(max_examples=15, deadline=None)
@given(st.lists(st.tuples(orders, st.floats(0.01, 1.0)), max_size=12))
def test_whatever_is_ordered_in_whatever_haste_no_command_exceeds_a_limit(
    given_orders: list[tuple[tuple[str, str | None], float]],
) -> None:
    fleet = driving(3.0, loss=0.1)
    for (do, shape), wait in given_orders:
        if shape is not None:
            fleet.order_shape(shape)
        for name in {"stop": SIX.names, "release": SIX.names, "shape": ()}.get(do, ("robot1",)):
            fleet.ask(name, do)
        fleet.run(wait)
        if fleet.leader.mode == "stop" and wait > 0.2:
            assert {fleet.last_command(name) for name in SIX.followers} == {AT_REST}
    assert fleet.within_limits
