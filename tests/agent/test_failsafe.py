"""The decision table: which doubt stops the robot, and which comes first."""

from __future__ import annotations

from typing import Any

import pytest

from agent.failsafe import TABLE, Facts, State, decide
from agent.motion_check import Disagreement, Kind
from formation.order import LEADER_LOST, Order

RUN = Order(term=1, beat=5, mode="run", shape="hexagon")
NEVER = float("inf")
FINE = Facts(
    latched=None,
    silence=0.01,
    limit=0.15,
    jumped=None,
    order=RUN,
    beat_silence=0.05,
    neighbours={"robot1": 0.02},
    fresh=1,
)

DOUBTS: list[tuple[dict[str, Any], State, str]] = [
    ({"latched": "stop"}, State.STOP, "stopped by the operator"),
    ({"latched": "hold"}, State.HOLD, "held by the operator"),
    ({"finite": False}, State.HOLD, "no finite command"),
    ({"silence": NEVER}, State.WAITING, "no odometry yet"),
    ({"silence": 0.16}, State.HOLD, "odometry silent for 0.16 s"),
    ({"connected": False}, State.HOLD, "no link to the robot"),
    ({"routed": False}, State.HOLD, "does not listen to cmd_vel"),
    ({"silence": 0.16, "source": "pose"}, State.HOLD, "pose silent for 0.16 s"),
    (
        {"too_old": True, "age": 0.4, "age_limit": 0.2},
        State.HOLD,
        "was 0.40 s old when it came; limit 0.20 s",
    ),
    ({"jumped": "0.80 m"}, State.HOLD, "odometry jumped 0.80 m"),
    ({"doubt": "is beyond ±1e+06 m"}, State.HOLD, "odometry is beyond"),
    ({"follows": False}, State.HOLD, "no two odometry messages within 0.15 s"),
    ({"outside": "x = 31.20 m, limit 25.00 m"}, State.HOLD, "outside the bounds: x = 31.20 m, limit 25.00 m"),
    ({"frozen": 3.2}, State.WAITING, "this process was frozen for 3.2 s"),
    ({"motion": Disagreement(Kind.FROZEN, 0.52, 0.0, 0.8)}, State.HOLD, "commanded 0.52 m in 0.8 s"),
    ({"motion": Disagreement(Kind.TURN, 0.5, 0.0, 0.8)}, State.HOLD, "turned 0.00 rad"),
    ({"motion": Disagreement(Kind.SPEEDS, 0.1, -0.1, 0.8)}, State.HOLD, "its speeds say -0.10 m"),
    ({"motion": Disagreement(Kind.CARRIED, 0.0, 0.1, 0.8)}, State.HOLD, "moved without command"),
    ({"motion": Disagreement(Kind.TURNED, 0.0, 0.5, 0.8)}, State.HOLD, "turned without command"),
    ({"scan_silence": NEVER}, State.WAITING, "no range scan yet"),
    ({"scan_silence": 0.7, "scan_limit": 0.6}, State.HOLD, "range scan silent for 0.70 s"),
    ({"scan_doubt": "has range_min 0.5 m"}, State.HOLD, "range scan has range_min 0.5 m"),
    ({"rival": True}, State.HOLD, "another agent commands this robot"),
    (
        {"mission": "0123abcd", "other_missions": {"robot1": "89ef4567"}},
        State.HOLD,
        "robot1 runs mission 89ef4567, this process 0123abcd: give all the same one (formation deploy push)",
    ),
    ({"order": None}, State.WAITING, "no order from the leader yet"),
    ({"beat_silence": LEADER_LOST + 0.2}, State.HOLD, "beat stopped 1.2 s ago"),
    ({"order": RUN.model_copy(update={"mode": "stop"})}, State.STOP, "stopped by the leader"),
    ({"order": RUN.model_copy(update={"mode": "hold"})}, State.HOLD, "held by the leader"),
    (
        {"beat_silence": 1.1, "unsigned": "order not signed by leader: it has no signature"},
        State.HOLD,
        "order not signed by leader: it has no signature",
    ),
    ({"fresh": 0, "neighbours": {"robot1": 0.4}}, State.HOLD, "no neighbour is fresh: robot1 0.40 s"),
    ({"fresh": 0, "neighbours": {"robot1": 0.4}, "leaderless": True}, State.HOLD, "is fresh: robot1 0.40 s"),
    (
        {"fresh": 0, "neighbours": {"robot1": 0.4, "robot2": 0.02}, "aside": ("robot2",)},
        State.HOLD,
        "no neighbour can be followed: robot1 0.40 s, robot2 is no guide",
    ),
    (
        {"fresh": 0, "neighbours": {"robot1": 0.02}, "aside": ("robot1",), "beyond": ("robot1",)},
        State.HOLD,
        "no neighbour can be followed: robot1 is outside the bounds",
    ),
]
TOGETHER: list[dict[str, Any]] = [
    {"order": None},
    {"order": RUN.model_copy(update={"mode": "stop"})},
    {"order": RUN.model_copy(update={"mode": "hold"})},
    {"fresh": 0, "leaderless": True},
]
"""What is not one robot's own affair."""


def test_a_robot_runs_when_there_is_no_doubt() -> None:
    assert decide(FINE).state is State.RUN


@pytest.mark.parametrize(("doubt", "state", "reason"), DOUBTS)
def test_every_single_doubt_keeps_the_robot_from_running_and_is_named(
    doubt: dict[str, Any], state: State, reason: str
) -> None:
    decision = decide(FINE._replace(**doubt))
    assert decision.state is state
    assert reason in decision.reason


def test_every_row_of_the_table_is_reached_by_some_doubt() -> None:
    reached = {
        next(i for i, row in enumerate(TABLE) if row.applies(FINE._replace(**d))) for d, _, _ in DOUBTS
    }
    assert reached | {len(TABLE) - 1} == set(range(len(TABLE)))


@pytest.mark.parametrize("doubt", [doubt for doubt, _, _ in DOUBTS])
def test_others_may_go_on_without_a_robot_unless_all_of_them_stand_for_the_same_reason(
    doubt: dict[str, Any],
) -> None:
    everybody = any(
        doubt == one or {**doubt, "neighbours": {}} == {**one, "neighbours": {}} for one in TOGETHER
    )
    assert decide(FINE._replace(**doubt)).own is not everybody


def test_a_robot_that_runs_has_no_reason_of_its_own_not_to() -> None:
    assert not decide(FINE).own


def test_only_the_last_row_lets_a_robot_run() -> None:
    assert [row.state for row in TABLE].index(State.RUN) == len(TABLE) - 1


@pytest.mark.parametrize(("doubt", "_state", "_reason"), DOUBTS)
def test_an_operators_stop_outranks_everything(doubt: dict[str, Any], _state: State, _reason: str) -> None:
    assert decide(FINE._replace(**{**doubt, "latched": "stop"})).reason == "stopped by the operator"
