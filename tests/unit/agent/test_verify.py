"""Verification of recorded runs: each command is computed exactly, or the first difference is named."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from formation.agent.core import Agent
from formation.agent.verify import core, replica
from formation.agent.verify.core import MAX_INPUT_DELAY, MOST_STRETCHES, Verdict, Verification
from formation.control.laws import LAWS
from formation.mission.file import load, parse, read
from formation.mission.model import Mission
from formation.monitor.metrics.keys import watched
from formation.protocol.attachment import PositionAttachment
from formation.protocol.request import MAX_REQUEST_BYTES
from formation.ros2.messages import Twist, encode
from formation.topics import BALLOT, CMD_VEL, ODOM, POSITION, SCAN
from formation.wire import Now, Sample
from tests.support.fleet import EPOCH
from tests.support.missions import team, with_robots
from tests.support.recorded import Looped, RecordedFleet, Recording, all_alike, verify
from tests.support.signed import SignedFleet

SIX, PAIR, CHAINS = load("six_robots"), load("turtlebot3_pair"), load("two_chains")
POSTS = load("posts")
STEPS = {"speed_step": 0.01, "turn_rate_step": 0.01}
COMMAND = CMD_VEL.key("robot3")


@cache
def recording() -> Recording:
    """A recording of six robots in their first 6 s."""
    return RecordedFleet(SIX).after(6.0).record


def changed(old: str, new: str, mission: str = "six_robots") -> Mission:
    text = read(mission)[0]
    assert old in text
    return parse(text.replace(old, new))


def without(record: Recording, *gone: Callable[[Sample, float], bool]) -> Recording:
    return [(sample, wall) for sample, wall in record if not any(one(sample, wall) for one in gone)]


def nth(number: int) -> int:
    """The index of a command of robot3 in the recording."""
    return [index for index, (sample, _) in enumerate(recording()) if sample.key == COMMAND][number]


def between(key: str, since: float, until: float) -> Callable[[Sample, float], bool]:
    start = recording()[0][1]
    return lambda sample, wall: sample.key == key and since <= wall - start < until


def command_of_another(sample: Sample, _: float) -> bool:
    """Whether it is a command that robot3 neither sends nor receives, so that only robot3 is verified."""
    return sample.key.endswith(f"/{CMD_VEL.name}") and sample.key != COMMAND


@pytest.mark.slow
def test_every_command_of_two_chains_is_reproduced_exactly() -> None:
    assert all_alike(verify(CHAINS, RecordedFleet(CHAINS, loss=0.1).after(6.0).record))


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(
    "mission",
    [
        SIX, PAIR,
        with_robots("six_robots", measurement="local"),
        with_robots("six_robots", odometry_frame="start"),
        with_robots("turtlebot3_pair", heading="measured"),
        with_robots("turtlebot3_pair", localisation="external", **STEPS),
        POSTS,
        with_robots("six_robots", measurement="scan", scanner="required"),
    ],
    ids=["six", "pair", "local", "start frame", "measured heading", "external", "posts", "seeing"],
)  # fmt: skip
def test_every_command_of_run_is_reproduced_exactly(mission: Mission, law: str) -> None:
    fleet = RecordedFleet(mission, law=law, loss=0.1).after(6.0)
    assert all_alike(verify(mission, fleet.record))


def test_every_subscription_of_agent_is_recorded_and_retained() -> None:
    text, name = read("posts")
    mission = parse(f"{text}\n[standbys.spare1]\n[standbys.spare2]\n", name)
    recorded = {one.key for one in watched(mission)}
    for robot in mission.followers:
        received = set(Agent(mission, robot).subscriptions)
        assert {BALLOT.key("spare2"), SCAN.key(robot)} <= received
        assert received <= recorded
        assert all(core._may_be_received(key) for key in received)


CHANGES = {
    "gain": ("[law]", "[law]\ngain = 8.000001"),
    "velocity filter": ("[law]", "[law]\nvelocity_filter = 0.0401"),
    "noise": ("[collisions]", "[collisions]\nnoise = 0.00201"),
    "control point": ("control_point_offset = 0.2 ", "control_point_offset = 0.200001 "),
    "limit": ("max_speed = 1.5 ", "max_speed = 1.49999 "),
    "delay compensation": ("[law]", "[law]\ndelay_compensation = false"),
    "feed-forward": ("[law]", "[law]\nfeed_forward = false"),
    "shape": ("robot5 = [-1.5, ", "robot5 = [-1.50001, "),
}


@pytest.mark.parametrize(("old", "new"), CHANGES.values(), ids=CHANGES)
def test_first_differing_command_is_named_after_mission_change(old: str, new: str) -> None:
    end = recording()[0][1] + 2.5
    verdicts = verify(changed(old, new), without(recording(), lambda _, wall: wall >= end))
    firsts = [one.first for one in verdicts.values() if one.first is not None]
    assert firsts
    first = min(firsts, key=lambda one: one.wall)
    recorded = [wall for sample, wall in recording() if sample.key.endswith(CMD_VEL.name)]
    assert first.wall in recorded
    assert first.recorded is not None
    assert first.computed is not None
    assert max(first.off) > 1e-9
    assert first.inputs[-1].key.endswith(ODOM.name)
    assert "formation control" in first.decision
    for one in verdicts.values():
        assert one.compared == one.commands  # comparison continues after a difference
        assert one.exact < one.compared or one.first is None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("payload", "recorded"),
    [(encode(Twist(0.1, 0.2)), (0.1, 0.2)), (b"\0\1\0\0 rubbish", None)],
    ids=["altered", "no command"],
)
def test_altered_command_in_recording_is_found(payload: bytes, recorded: tuple[float, float] | None) -> None:
    at = nth(50)
    forged = list(recording())
    forged[at] = (recording()[at][0]._replace(payload=payload), recording()[at][1])
    one = verify(SIX, forged)["robot3"]
    assert one.first is not None
    assert (one.differing, one.first.number) == (1, 51)
    assert (one.first.recorded and one.first.recorded[:2]) == recorded


def test_recording_without_beginning_is_judged_from_first_state() -> None:
    start = recording()[0][1]
    verdicts = verify(SIX, without(recording(), lambda _, wall: wall <= start + 2.0))
    for one in verdicts.values():
        assert 0 < one.compared == one.exact < one.commands
        (stretch,) = one.unjudged
        assert "beginning is not in the recording" in stretch.reason
        assert stretch.commands == one.commands - one.compared
        assert stretch.until - start < 5.2


def test_commands_after_missing_message_are_unjudged_until_next_state() -> None:
    one = verify(SIX, without(recording(), between(POSITION.key("robot1"), 2.0, 2.01 + 0.05)))["robot3"]
    (stretch,) = one.unjudged
    assert "robot1/position" in stretch.reason
    assert one.compared == one.exact == one.commands - stretch.commands
    assert 1.9 < stretch.since - recording()[0][1] < 2.3
    assert 4.9 < stretch.until - recording()[0][1] < 5.3


def test_missing_commands_are_counted() -> None:
    one = verify(SIX, without(recording(), between(COMMAND, 2.0, 2.21)))["robot3"]
    (stretch,) = one.unjudged
    assert stretch.reason in {f"{number} commands before it missing in the recording" for number in (4, 5)}
    assert one.compared == one.exact == one.commands - stretch.commands


def test_only_repeated_command_is_left_unjudged() -> None:
    at = nth(50)
    one = verify(SIX, [*recording()[: at + 1], recording()[at], *recording()[at + 1 :]])["robot3"]
    assert [(stretch.commands, stretch.reason) for stretch in one.unjudged] == [(1, "comes a second time")]
    assert one.compared == one.exact == one.commands - 1


@pytest.mark.parametrize("late", [0.0, 0.5 * MAX_INPUT_DELAY])
def test_recorded_order_between_keys_does_not_matter(late: float) -> None:
    """Each key by itself is in order; keys differ in their delay."""
    slow = [
        (sample, wall + (late if sample.key.endswith(POSITION.name) else 0.0)) for sample, wall in recording()
    ]
    assert all_alike(verify(SIX, sorted(slow, key=lambda one: one[1])))


@pytest.mark.slow
def test_clock_step_of_recorder_does_not_matter() -> None:
    middle = len(recording()) // 2
    for leap in (3600.0, -3600.0):
        leapt = [*recording()[:middle], *((sample, wall + leap) for sample, wall in recording()[middle:])]
        assert all_alike(verify(SIX, leapt))


@pytest.mark.slow
@settings(max_examples=25)
@given(data=st.data())
def test_lossy_recording_shows_no_false_difference(data: st.DataObject) -> None:
    share, seed = data.draw(st.sampled_from([0.001, 0.05, 0.5])), data.draw(st.integers(0, 2**32 - 1))
    gone = np.random.default_rng(seed).random(len(recording())) < share
    first = data.draw(st.integers(0, len(recording()) - 1))
    part = [one for one, lost in zip(recording(), gone, strict=True) if not lost][first:]
    for one in verify(SIX, part).values():
        assert one.exact == one.compared
        assert one.commands == one.compared + sum(stretch.commands for stretch in one.unjudged)
        assert one.commands == sum(sample.key == CMD_VEL.key(one.robot) for sample, _ in part)


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(data=st.data())
def test_tampered_trace_never_ends_verification(data: st.DataObject) -> None:
    rubbish: Any = data.draw(
        st.sampled_from([None, True, -1, 1e300, "x", [], {}, [[1.0, 2.0, [[9, 9, 9.0]]]]])
    )
    number = nth(data.draw(st.sampled_from([0, 3, 40])))
    sample, wall = recording()[number]
    result = json.loads(sample.attachment or b"")
    name = data.draw(st.sampled_from([*result, "state", "gap", "agent", "halt"]))
    inner = result[name] if isinstance(result.get(name), dict) and data.draw(st.booleans()) else None
    if inner is None:
        result[name] = rubbish
    else:
        inner[data.draw(st.sampled_from(sorted(inner)))] = rubbish
    forged = sample._replace(attachment=json.dumps(result).encode())
    with_forged = [*recording()[:number], (forged, wall), *recording()[number + 1 :]]
    one = verify(SIX, without(with_forged, command_of_another))["robot3"]
    assert one.commands == sum(sample.key == COMMAND for sample, _ in recording())


def test_failing_agent_counts_as_one_difference(monkeypatch: pytest.MonkeyPatch) -> None:
    count = itertools.count()
    act = Agent.act

    def fails_once(self: Agent, now: Now, inbox: Any) -> Any:
        if next(count) == 500:
            raise ZeroDivisionError("of today")
        return act(self, now, inbox)

    monkeypatch.setattr(Agent, "act", fails_once)
    found = [one for one in verify(SIX, recording()).values() if one.first is not None]
    (one,) = found
    assert one.first is not None
    assert one.first.computed is None
    assert one.first.decision == "fails: ZeroDivisionError: of today"
    assert one.differing == 1
    assert one.exact > 50


def test_mission_without_recorded_neighbour_gives_a_difference() -> None:
    fewer = changed('neighbours = ["robot1", "robot2"]', 'neighbours = ["robot2"]')
    verdicts = verify(fewer, recording())
    assert verdicts["robot3"].first is not None
    assert verdicts["robot2"].first is None


def test_verification_retains_only_a_few_seconds() -> None:
    verification = Verification(SIX)
    start, kept = recording()[0][1], list[int]()
    for hour in range(3):
        for sample, wall in recording():
            verification.process_sample(sample, wall + 6.0 * hour)
            kept.append(len(verification._buffer._found))
    a_second = len(without(recording(), lambda _, wall: wall > start + 1.0))
    assert max(kept) < (replica.MAX_STORED_TIME + core.MAX_INPUT_DELAY + 1.0) * a_second
    assert len(verification._due) < MAX_INPUT_DELAY * a_second
    assert not verification._awaited or max(map(len, verification._awaited.values())) < 10


def test_number_of_listed_stretches_is_limited() -> None:
    verdict = Verdict("robot3")
    for number in range(3 * MOST_STRETCHES):
        verdict.passed_over(float(number), f"reason {number}")
    assert len(verdict.unjudged) == MOST_STRETCHES
    assert sum(stretch.commands for stretch in verdict.unjudged) == verdict.commands == 3 * MOST_STRETCHES
    assert verdict.unjudged[-1].reason == "several reasons"


def test_unrecorded_start_of_new_agent_is_given_as_reason() -> None:
    fleet = RecordedFleet.under_way(SIX, 2.0)
    fleet.restart("robot3")
    cut = len(fleet.record)
    fleet.run(1.0)
    end = len(fleet.record)
    fleet.run(2.0)
    one = verify(SIX, fleet.record[:cut] + fleet.record[end:])["robot3"]
    assert ["another agent publishes" in stretch.reason for stretch in one.unjudged] == [True]


def test_two_agents_of_one_robot_are_both_judged() -> None:
    fleet = RecordedFleet.under_way(SIX, 2.0)
    other = Looped(fleet.new_agent("robot3"), fleet.record)
    step = fleet.loop("robot3").step

    def both(now: Now, inbox: Any) -> Any:
        other.step(now, inbox)
        return step(now, inbox)

    fleet.loop("robot3").step = both  # type: ignore[method-assign]
    fleet.run(2.0)
    one = verify(SIX, fleet.record)["robot3"]
    assert one.commands > 110
    assert one.exact == one.commands


def test_requests_link_outage_new_agent_and_halt_are_reproduced() -> None:
    fleet = RecordedFleet(PAIR).after(2.0)
    for words in ("stop a", "release b", "hold ", "release b", "stop b", "stop a", "release ", "run "):
        do, number = words.split(" ")
        fleet.tell("robot1", do, id=number)
        fleet.run(0.5)
    fleet.loop("robot1").sides.request(b'{"do":"stop"}'.ljust(MAX_REQUEST_BYTES), fleet.now)
    fleet.loop("robot2").robot.connected = False
    fleet.run(1.0)
    fleet.loop("robot2").robot.connected = True
    fleet.run(1.0)
    fleet.kill("robot2")
    fleet.run(1.0)
    fleet.restart("robot2")
    fleet.run(3.0)
    fleet.ask("leader", "stop")
    fleet.run(1.0)
    for name in PAIR.followers:
        fleet.halt(name)
    assert all_alike(verify(PAIR, fleet.record))


@pytest.mark.parametrize("mission", [SIX, with_robots("turtlebot3_pair", localisation="external")])
def test_readonly_agent_is_verified(mission: Mission) -> None:
    fleet = RecordedFleet(mission)
    name = mission.followers[0]
    agent = Agent(mission, name, readonly=True, publisher_id="looks")
    fleet.nodes[name].core = Looped(agent, fleet.record)
    fleet.run(3.0)
    assert all_alike(verify(mission, fleet.record))


TEAM = team({"r0": ["leader"], "r1": ["leader"], "r2": ["r0", "r1"]})


@dataclass
class SignedRecordedFleet(RecordedFleet, SignedFleet):
    """A recorded fleet with a certificate for each process."""

    def passed(self, sample: Sample) -> None:
        self.record.append((sample, EPOCH + self.now))


def unsigned(sender: str, attachment: PositionAttachment) -> PositionAttachment:
    """Have r0 relay forged stop orders without signature."""
    if sender != "r0" or attachment.order is None:
        return attachment
    what = attachment.order.model_copy(update={"mode": "stop"})
    return attachment.model_copy(update={"order": what, "signed": "", "signature": ""})


def test_signed_run_and_refused_orders_are_reproduced_without_keys() -> None:
    """In the end r2 receives only refused orders and holds; its replica must do the same."""
    fleet = SignedRecordedFleet(TEAM, loss=0.1)
    fleet.run(4.0)
    assert any(b"certificate" in (sample.attachment or b"") for sample, _ in fleet.record)
    fleet.tamper = unsigned
    fleet.kill("r1")
    fleet.run(2.5)
    assert str(fleet.agents["r2"].decision.reason) == "order not signed by leader: it has no signature"
    assert all_alike(verify(TEAM, fleet.record))
