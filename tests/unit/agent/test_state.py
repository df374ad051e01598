"""State of an agent, restored into another by JSON: both then behave alike."""

from __future__ import annotations

import cmath
import json
import math
import struct
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from functools import partial
from types import FunctionType, MappingProxyType, MethodType
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import BaseModel

from formation.agent.core import Agent
from formation.agent.persistence.state import BadStateError, Codec, dump, restore
from formation.agent.status import Surroundings
from formation.control.laws import LAWS
from formation.mission.file import load
from formation.mission.model import Mission
from formation.protocol.json_message import encode
from formation.protocol.request import OperatorRequest
from formation.ros2.messages import Odometry, decode
from formation.ros2.messages import encode as encode_message
from formation.topics import ODOM, POSE
from formation.wire import Now, Outgoing, Sample
from tests.support.examples import slow
from tests.support.fleet import EPOCH, Fleet
from tests.support.missions import with_robots

STEPS = {"speed_step": 0.01, "turn_rate_step": 0.01}
MISSIONS: dict[str, Mission] = {
    "six": load("six_robots"),
    "pair": load("turtlebot3_pair"),
    "fallbacks": load("patrol"),
    "start frame": with_robots("six_robots", odometry_frame="start"),
    "map": with_robots("turtlebot3_pair", odometry_frame="map"),
    "avoiding": with_robots("six_robots", avoid="all"),
    "scanning": with_robots("six_robots", scanner="required"),
    "scanning pair": with_robots("turtlebot3_pair", scanner="optional", **STEPS),
    "local": with_robots("six_robots", measurement="local"),
    "seeing": with_robots("six_robots", measurement="scan", scanner="required"),
    "measured heading": with_robots("turtlebot3_pair", heading="measured"),
    "external": with_robots("turtlebot3_pair", localisation="external", **STEPS),
    "external measured": with_robots("six_robots", localisation="external", heading="measured"),
}

QUICK = ("pair", "fallbacks", "start frame", "map", "seeing", "external")


def dumped_by_json(agent: Agent) -> Any:
    return json.loads(json.dumps(dump(agent), allow_nan=False))


def new_agent_like(agent: Agent) -> Agent:
    """A new agent with the same mission, robot, law and publisher id."""
    return Agent(
        agent.mission,
        agent.robot,
        agent.controller.name,
        readonly=agent.readonly,
        publisher_id=agent.publisher_id,
    )


class Twins:
    """An agent and, after `double`, a second one with its state: both must send the same."""

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
        other = new_agent_like(self.agents[0])
        restore(other, dumped_by_json(self.agents[0]))
        self.agents = [self.agents[0], other]

    def step(self, now: Now, inbox: Sequence[Sample]) -> list[Outgoing]:
        around = self.surroundings()
        result = []
        for one in self.agents:
            one.aware(around)
            result.append(one.step(now, inbox))
        outbox: list[Outgoing] = self._same(result)
        return outbox

    def request(self, data: bytes, received: float) -> bytes:
        reply: bytes = self._same([one.request(data, received) for one in self.agents])
        return reply

    def halt(self, now: Now, reason: str) -> list[Outgoing]:
        outbox: list[Outgoing] = self._same([list(one.halt(now, reason)) for one in self.agents])
        return outbox

    def _same(self, result: Sequence[Any]) -> Any:
        assert all(one == result[0] for one in result)
        self.compared += len(result) - 1
        return result[0]


ORDERS = st.sampled_from(["stop", "hold", "run", "release"])


class World:
    """A fleet of twins with random events."""

    def __init__(self, data: st.DataObject) -> None:
        draw = data.draw
        self.fleet = Fleet(
            MISSIONS[draw(st.sampled_from(sorted(MISSIONS)))],
            law=draw(st.sampled_from(sorted(LAWS))),
            seed=draw(st.integers(0, 1000)),
            loss=draw(st.sampled_from([0.0, 0.1, 0.5])),
            delay=(0.0, draw(st.sampled_from([0.002, 0.1, 0.4]))),
        )
        self.fleet.meddle = self._meddled
        self.offset, self.silent = 0j, False
        self.around = Surroundings(True, True, {})
        for name, node in self.fleet.nodes.items():
            if name in self.fleet.agents:
                node.core = Twins(self.fleet.agents[name], lambda: self.around)
            node.clock_error = draw(st.sampled_from([0.0, 0.0, 0.05, -3.0]))

    def twins(self) -> list[Twins]:
        return [node.core for node in self.fleet.nodes.values() if isinstance(node.core, Twins)]

    def happen(self, data: st.DataObject) -> None:
        """Have one random event happen, and let some time pass."""
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
            self.fleet.order_shape(data.draw(st.sampled_from(sorted(self.fleet.mission.shapes))))
        elif what == "jump":
            self.offset += data.draw(st.sampled_from([0.5 + 0j, -3j]))
        elif what == "restart":
            fresh = Twins(self.fleet.new_agent(name), lambda: self.around)
            if len(twins.agents) > 1:
                fresh.double()
            self.fleet.nodes[name].core = fresh
        elif what == "silence":
            self.silent = not self.silent
        elif what == "link":
            self.around = Surroundings(data.draw(st.booleans()), data.draw(st.booleans()), {"put x": 3})
        elif what == "leader":
            self.fleet.kill("leader") if self.fleet.nodes["leader"].alive else self.fleet.revive("leader")
        self.fleet.run(data.draw(st.floats(0.1, 1.0)))

    def _meddled(self, sample: Sample) -> Iterator[Sample]:
        own = sample.key.endswith((ODOM.name, POSE.name))
        if own and self.silent:
            return
        if sample.key.endswith(ODOM.name):
            seen = decode(Odometry, sample.payload)
            moved = Odometry(
                seen.stamp, seen.position + self.offset, seen.heading, seen.speed, seen.turn_rate
            )
            sample = sample._replace(payload=encode_message(moved))
        yield sample


@pytest.mark.slow
@settings(max_examples=30)
@given(data=st.data())
def test_agent_with_restored_state_sends_identical_bytes(data: st.DataObject) -> None:
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
        first = dump(twins.agents[0])
        assert all(dump(one) == first for one in twins.agents)
        twins.halt(Now(world.fleet.now, EPOCH + world.fleet.now), "the end")
    assert sum(twins.compared for twins in world.twins()) > 10


def objects(thing: Any, where: str, seen: set[int]) -> Iterator[tuple[str, Any]]:
    """`thing` and every object of this program reachable from it, with its place; not those in states."""
    if id(thing) in seen:
        return
    seen.add(id(thing))
    if isinstance(thing, (list, tuple)):
        items = [(f"{where}[{i}]", one) for i, one in enumerate(thing)]
    elif isinstance(thing, dict):
        items = [(f"{where}[{key!r}]", one) for key, one in thing.items()]
    elif isinstance(thing, partial):
        items = [(where, thing.args)]
    elif isinstance(thing, MethodType):
        items = [(where, thing.__self__)]
    elif is_part(thing):
        yield where, thing
        items = [(f"{where}.{name}", one) for name, one in vars(thing).items() if name != "state"]
    else:
        return
    for place, one in items:
        yield from objects(one, place, seen)


def is_part(thing: Any) -> bool:
    """Whether it is an ordinary object of this program: no model, no record, no value."""
    of = type(thing)
    ours = of.__module__.startswith("formation.") and hasattr(thing, "__dict__")
    return ours and not isinstance(thing, (BaseModel, type, tuple, Enum)) and not is_dataclass(thing)


def comparable(thing: Any) -> Any:
    """A copy of a value for comparison, in which the id of a part stands for it."""
    if isinstance(thing, dict):
        return {key: comparable(one) for key, one in thing.items()}
    if isinstance(thing, (list, tuple, deque)):
        return [comparable(one) for one in thing]
    if isinstance(thing, partial):
        return comparable(thing.args)
    if is_part(thing) or isinstance(thing, MethodType):
        return id(thing)
    return thing if isinstance(thing, (BaseModel, FunctionType, MappingProxyType)) else deepcopy(thing)


def outside_states(agent: Agent) -> dict[str, Any]:
    """Every attribute of an agent and its parts that is in no state, by place."""
    return {
        f"{where}.{name}": comparable(value)
        for where, one in objects(agent, "agent", set())
        for name, value in vars(one).items()
        if name not in {"state", "_boxes"}  # a geofence stores which shapes it has checked
    }


@pytest.mark.parametrize("kind", [*QUICK, *slow(*(one for one in MISSIONS if one not in QUICK))])
def test_run_changes_only_states_of_agent(kind: str) -> None:
    mission = MISSIONS[kind]
    fleet = Fleet(mission)
    fresh = {name: outside_states(agent) for name, agent in fleet.agents.items()}
    fleet.run(2.0)
    for name in fleet.agents:
        fleet.ask(name, "hold")
    fleet.order_shape(next(iter(mission.shapes)))
    fleet.run(0.5)
    for name, agent in fleet.agents.items():
        assert outside_states(agent) == fresh[name]
        assert len(fresh[name]) > 80


def states(thing: Any) -> Iterator[Any]:
    """A state, and all states in it."""
    yield thing
    for one in fields(thing):
        value = getattr(thing, one.name)
        for part in value.values() if isinstance(value, dict) else (value,):
            if is_dataclass(part):
                yield from states(part)


@pytest.mark.parametrize("mission", MISSIONS.values(), ids=MISSIONS)
def test_agent_state_contains_states_of_all_parts(mission: Mission) -> None:
    agent = Agent(mission, mission.followers[0])
    for saved in (None, dump(agent)):
        if saved is not None:
            restore(agent, saved)
        found = {id(state) for state in states(agent.state)}
        own = {where: one.state for where, one in objects(agent, "agent", set()) if hasattr(one, "state")}
        assert {where for where, state in own.items() if id(state) not in found} == set()
        assert len(own) > 12


@dataclass(slots=True)
class Numbers:
    real: float
    plane: complex


NUMBERS = Codec(Numbers)


def round_trip(numbers: Numbers) -> Numbers:
    return NUMBERS.read(json.dumps(NUMBERS.write(numbers), allow_nan=False).encode())


@given(st.floats(), st.complex_numbers())
def test_codec_restores_every_number_exactly(real: float, plane: complex) -> None:
    restored = round_trip(Numbers(real, plane))
    assert (type(restored.real), type(restored.plane)) == (float, complex)
    assert struct.pack("d", restored.real) == struct.pack("d", real) or math.isnan(real)
    parts = [struct.pack("2d", one.real, one.imag) for one in (restored.plane, plane)]
    assert parts[0] == parts[1] or cmath.isnan(plane)


ROBOT3 = Fleet(MISSIONS["six"]).after(3.0).agents["robot3"]
SAVED = dumped_by_json(ROBOT3)
LEAVES = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=5), st.just([]), st.just({}),
    st.just([1.0]), st.just([1.0, 2.0, 3.0]), st.just([1.0, "x"]), st.just({"x": 1}),
)  # fmt: skip


def places(result: Any) -> Iterator[tuple[Any, Any]]:
    """Every place in a JSON value: container and index."""
    if isinstance(result, (dict, list)):
        for index, one in result.items() if isinstance(result, dict) else enumerate(result):
            yield result, index
            yield from places(one)


@given(data=st.data())
def test_invalid_state_is_refused_and_changes_nothing(data: st.DataObject) -> None:
    saved = deepcopy(SAVED)
    container, index = data.draw(st.sampled_from(list(places(saved))))
    if isinstance(container, dict) and data.draw(st.booleans()):
        container.pop(index)
    else:
        container[index] = data.draw(LEAVES)
    agent = new_agent_like(ROBOT3)
    before, refused = dump(agent), ""
    try:
        restore(agent, saved)
    except BadStateError as bad:
        refused = str(bad)
    if not refused:  # the changed state is valid: an agent with it can dump its state
        json.dumps(dump(agent), allow_nan=False)
    else:
        assert refused.startswith("state")
        assert "\n" not in refused
        assert dump(agent) == before


@pytest.mark.parametrize("saved", [None, 1, "x", [], {}, [{}], {"x": 1}])
def test_values_that_are_no_state_are_refused(saved: Any) -> None:
    with pytest.raises(BadStateError):
        restore(new_agent_like(ROBOT3), saved)


def test_state_of_robot_with_other_neighbours_is_refused() -> None:
    with pytest.raises(BadStateError, match=r"state\.neighbours\.each\.robot\d"):
        restore(Agent(MISSIONS["six"], "robot6"), SAVED)
