"""A fleet that other tests copy: the copy goes on as the fleet would, and neither notices the other."""

from __future__ import annotations

from formation.mission.file import load
from tests.support.fleet import Fleet
from tests.support.restarting import Team


def events(fleet: Fleet) -> tuple[object, ...]:
    """Have this and that happen to a fleet, and return what it does."""
    name = fleet.mission.followers[-1]
    fleet.kill(name)
    fleet.run(0.5)
    fleet.ask("leader", "stop")
    fleet.run(0.5)
    fleet.restart(name)
    fleet.set_going(name)
    fleet.set_going("leader")
    fleet.run(2.0)
    return dict(fleet.commands), [fleet.message(one) for one in fleet.agents], fleet.leader_terms


def test_copied_fleets_do_the_same_as_a_new_one() -> None:
    for kind, name in ((Team, "turtlebot3_pair"), (Fleet, "patrol")):
        mission = load(name)
        new = events(kind(mission, loss=0.1).after(2.0))
        assert [events(kind.under_way(mission, 2.0, loss=0.1)) for _ in range(2)] == [new] * 2
