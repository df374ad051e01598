"""What an agent has learned can be taken down and given to another, and the two are then one."""

from __future__ import annotations

import cmath
import json
import math
import struct
from collections.abc import Callable, Iterator, Sequence
from copy import deepcopy
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agent import values
from agent.core import Agent
from agent.kept import KEPT
from agent.memory import BadMemoryError, recall, remember
from agent.status import Surroundings
from formation.mission import Mission
from formation.mission_file import load
from formation.order import OperatorRequest, encode
from formation.ros2.messages import Odometry, decode
from formation.ros2.messages import encode as encode_message
from formation.topics import ODOM, POSE
from formation.wire import Now, Outgoing, Sample
from tests.agent.fleet import EPOCH, Fleet
from tests.agent.missions import with_robots

STEPS = {"speed_step": 0.01, "turn_rate_step": 0.01}
MISSIONS: dict[str, Mission] = {
    "six": load("six_robots"),
    "pair": load("turtlebot3_pair"),
    "fallbacks": load("patrol"),
    "start frame": with_robots("six_robots", odometry_frame="start"),
    "minding": with_robots("six_robots", mind="all"),
    "scanning": with_robots("six_robots", scanner="required"),
    "scanning pair": with_robots("turtlebot3_pair", scanner="optional", **STEPS),
    "local": with_robots("six_robots", measurement="local"),
    "measured heading": with_robots("turtlebot3_pair", heading="measured"),
    "external": with_robots("turtlebot3_pair", localisation="external", **STEPS),
    "external measured": with_robots("six_robots", localisation="external", heading="measured"),
}


def parts(thing: Any) -> Iterator[Any]:
    """It, and all that has a memory of its own in it."""
    yield thing
    for name in KEPT[type(thing)].parts:
        part = getattr(thing, name)
        for one in part.values() if isinstance(part, dict) else (part,):
            if one is not None:
                yield from parts(one)


def through_a_file(agent: Agent) -> Any:
    return json.loads(json.dumps(remember(agent), allow_nan=False))


def like(agent: Agent) -> Agent:
    """Another with the same mission, robot, law and voice, that has learned nothing."""
    return Agent(agent._mission, agent.robot, agent.law_name, readonly=agent._readonly, voice=agent._voice)


class Twins:
    """An agent, and from some moment on another that was given its memory: they must say the same."""

    def __init__(self, agent: Agent, surroundings: Callable[[], Surroundings]) -> None:
        self.agents = [agent]
        self.surroundings = surroundings
        self.compared = 0
        self.publications, self.subscriptions, self.dropped = (
            agent.publications, agent.subscriptions, agent.dropped
        )  # fmt: skip

    @property
    def due(self) -> float:
        first, *others = [one.due for one in self.agents]
        assert all(due == first for due in others)
        return first

    def double(self) -> None:
        other = like(self.agents[0])
        recall(other, through_a_file(self.agents[0]))
        self.agents = [self.agents[0], other]

    def step(self, now: Now, inbox: Sequence[Sample]) -> list[Outgoing]:
        around = self.surroundings()
        said = []
        for one in self.agents:
            one.aware(around)
            said.append(one.step(now, inbox))
        outbox: list[Outgoing] = self._same(said)
        return outbox

    def request(self, data: bytes, heard: float) -> bytes:
        reply: bytes = self._same([one.request(data, heard) for one in self.agents])
        return reply

    def halt(self, now: Now, reason: str) -> list[Outgoing]:
        outbox: list[Outgoing] = self._same([list(one.halt(now, reason)) for one in self.agents])
        return outbox

    def _same(self, said: Sequence[Any]) -> Any:
        assert all(one == said[0] for one in said)
        self.compared += len(said) - 1
        return said[0]


ORDERS = st.sampled_from(["stop", "hold", "run", "release"])


class World:
    """A fleet of twins, to which anything may happen."""

    def __init__(self, data: st.DataObject) -> None:
        draw = data.draw
        self.fleet = Fleet(
            MISSIONS[draw(st.sampled_from(sorted(MISSIONS)))],
            law=draw(st.sampled_from(["field", "paper"])),
            seed=draw(st.integers(0, 1000)),
            loss=draw(st.sampled_from([0.0, 0.1, 0.5])),
            delay=(0.0, draw(st.sampled_from([0.002, 0.1, 0.4]))),
        )
        self.fleet.meddle = self._meddled
        self.offset, self.deaf = 0j, False
        self.around = Surroundings(True, True, {})
        for name, node in self.fleet.nodes.items():
            if name in self.fleet.agents:
                node.core = Twins(self.fleet.agents[name], lambda: self.around)
            node.clock_error = draw(st.sampled_from([0.0, 0.0, 0.05, -3.0]))

    def twins(self) -> list[Twins]:
        return [node.core for node in self.fleet.nodes.values() if isinstance(node.core, Twins)]

    def happen(self, data: st.DataObject) -> None:
        """One thing that happens, and some time after it."""
        what = data.draw(
            st.sampled_from(["nothing", "order", "shape", "jump", "restart", "silence", "link", "leader"])
        )
        name = data.draw(st.sampled_from(self.fleet.mission.followers))
        twins = self.fleet.nodes[name].core
        assert isinstance(twins, Twins)
        if what == "order":
            do, number = data.draw(ORDERS), data.draw(st.sampled_from(["", "a", "b"]))
            twins.request(encode(OperatorRequest.model_validate({"do": do, "id": number})), self.fleet.now)
        elif what == "shape":
            self.fleet.take(data.draw(st.sampled_from(sorted(self.fleet.mission.shapes))))
        elif what == "jump":
            self.offset += data.draw(st.sampled_from([0.5 + 0j, -3j]))
        elif what == "restart":
            fresh = self.fleet.new_agent(name)
            self.fleet.nodes[name].core = Twins(fresh, lambda: self.around)
        elif what == "silence":
            self.deaf = not self.deaf
        elif what == "link":
            self.around = Surroundings(data.draw(st.booleans()), data.draw(st.booleans()), {"put x": 3})
        elif what == "leader":
            self.fleet.kill("leader") if self.fleet.nodes["leader"].alive else self.fleet.revive("leader")
        self.fleet.run(data.draw(st.floats(0.1, 1.0)))

    def _meddled(self, sample: Sample) -> Iterator[Sample]:
        own = sample.key.endswith((ODOM.name, POSE.name))
        if own and self.deaf:
            return
        if sample.key.endswith(ODOM.name):
            seen = decode(Odometry, sample.payload)
            moved = Odometry(
                seen.stamp, seen.position + self.offset, seen.heading, seen.speed, seen.turn_rate
            )
            sample = sample._replace(payload=encode_message(moved))
        yield sample


@settings(max_examples=30)
@given(data=st.data())
def test_an_agent_that_recalls_what_another_remembers_says_the_same_bytes_for_ever(
    data: st.DataObject,
) -> None:
    world = World(data)
    world.fleet.run(data.draw(st.floats(0.0, 4.0)))
    for _ in range(data.draw(st.integers(0, 3))):
        world.happen(data)
    for twins in world.twins():
        twins.double()
    for _ in range(data.draw(st.integers(1, 3))):
        world.happen(data)
    world.fleet.run(1.0)
    for twins in world.twins():
        first = remember(twins.agents[0])
        assert all(remember(one) == first for one in twins.agents)
        twins.halt(Now(world.fleet.now, EPOCH + world.fleet.now), "the end")
    assert sum(twins.compared for twins in world.twins()) > 10


@pytest.mark.parametrize("mission", MISSIONS.values(), ids=MISSIONS)
@pytest.mark.parametrize("law", ["field", "paper"])
def test_every_attribute_of_an_agent_is_either_memory_or_settled_by_its_construction(
    mission: Mission, law: str
) -> None:
    agent = Agent(mission, mission.followers[0], law)
    for one in parts(agent):
        kept = KEPT[type(one)]
        named = [*kept.memory, *kept.parts, *kept.construction]
        assert sorted(named) == sorted(vars(one)), type(one).__name__


@pytest.mark.parametrize("mission", MISSIONS.values(), ids=MISSIONS)
def test_what_is_said_to_be_settled_by_construction_is_not_changed_by_a_run(mission: Mission) -> None:
    fleet = Fleet(mission)
    fleet.run(3.0)
    for name, agent in fleet.agents.items():
        fleet.ask(name, "hold")
        for one, fresh in zip(parts(agent), parts(like(agent)), strict=True):
            for attribute in KEPT[type(one)].construction:
                then, now = getattr(fresh, attribute), getattr(one, attribute)
                if attribute == "_handlers":  # bound to parts of the agent itself
                    then, now = list(then), list(now)
                assert now == then, (type(one).__name__, attribute)


@given(st.floats())
def test_every_number_is_recalled_to_the_last_bit(number: float) -> None:
    again = values.real.read(json.loads(json.dumps(values.real.said(number), allow_nan=False)), "it")
    assert type(again) is float
    assert struct.pack("d", again) == struct.pack("d", number) or math.isnan(number)


@given(st.complex_numbers())
def test_so_is_every_vector(number: complex) -> None:
    again = values.plane.read(json.loads(json.dumps(values.plane.said(number), allow_nan=False)), "it")
    assert type(again) is complex
    parts = [struct.pack("2d", one.real, one.imag) for one in (again, number)]
    assert parts[0] == parts[1] or cmath.isnan(number)


def remembered() -> tuple[Agent, Any]:
    fleet = Fleet(MISSIONS["six"])
    fleet.run(3.0)
    return fleet.agents["robot3"], through_a_file(fleet.agents["robot3"])


ROBOT3, MEMORY = remembered()
LEAVES = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=5), st.just([]), st.just({}),
    st.just([1.0]), st.just([1.0, 2.0, 3.0]), st.just([1.0, "x"]), st.just({"x": 1}),
)  # fmt: skip


def places(said: Any) -> list[tuple[Any, Any]]:
    """Every place in a JSON value: container and index."""
    items = said.items() if isinstance(said, dict) else enumerate(said) if isinstance(said, list) else ()
    found = []
    for index, one in items:
        found += [(said, index), *places(one)]
    return found


def refusal(agent: Agent, memory: Any) -> str | None:
    try:
        recall(agent, memory)
    except BadMemoryError as bad:
        return str(bad)
    return None


@given(data=st.data())
def test_a_memory_that_is_none_is_refused_in_one_line_that_names_the_place_and_changes_nothing(
    data: st.DataObject,
) -> None:
    memory = deepcopy(MEMORY)
    container, index = data.draw(st.sampled_from(places(memory)))
    if isinstance(container, dict) and data.draw(st.booleans()):
        container.pop(index)
    else:
        container[index] = data.draw(LEAVES)
    agent = like(ROBOT3)
    before, refused = remember(agent), refusal(agent, memory)
    if refused is None:  # it was a legal one: an agent that has it can say so
        json.dumps(remember(agent), allow_nan=False)
    else:
        assert refused.startswith("memory")
        assert "\n" not in refused
        assert remember(agent) == before


@pytest.mark.parametrize("memory", [None, 1, "x", [], {}, [{}], {"x": 1}])
def test_what_is_no_memory_at_all_is_refused_as_well(memory: Any) -> None:
    with pytest.raises(BadMemoryError):
        recall(like(ROBOT3), memory)


def test_the_memory_of_another_robot_is_refused_for_the_neighbours_that_it_has() -> None:
    with pytest.raises(BadMemoryError, match=r"memory\.neighbours\.each\.robot\d"):
        recall(Agent(MISSIONS["six"], "robot6"), MEMORY)
