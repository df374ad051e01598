"""The failsafe table: which doubt leads to which state and reason, and which comes first."""

from __future__ import annotations

from typing import Any

import pytest

from formation.agent.pose.motion_check import Disagreement
from formation.agent.safety.failsafe import TABLE, Decision, Facts, Unanswered, decide
from formation.protocol.order import LEADER_TIMEOUT_SECONDS, Order
from formation.protocol.reasons import Code, Reason
from formation.protocol.status import AgentState, MotionFault

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
    followed=1,
)


def reason(code: Code, **values: float) -> Reason:
    return Reason.of(code, source="odometry", **values)


OUTSIDE = Reason.of(Code.OUTSIDE_BOUNDS, axis="x", value=31.2, limit=25.0)
SEARCHING = Reason.of(Code.SIGHT_SEARCHING, robots=("robot2",), count=3, limit=5, unplaced=())
LATE = Reason.of(Code.RELATIVE_LATE, robot="robot3", age=1.0, limit=0.18)
SCAN_REFUSED = "range scan comes, and is refused: absurd stamp"
OTHER_MISSION = (
    "robot1 runs mission 89ef4567, this process 0123abcd: give all the same one (formation deploy push)"
)
UNANSWERED = "do not answer: robot3 by +3.0 s, robot4 by -7.2 s; limit 0.5 s; check the network"
UNSIGNED = "order not signed by leader: it has no signature"
GONE, NONE = {"robot1": 0.4}, "no neighbour can be followed"
HOLD: list[tuple[dict[str, Any], str]] = [
    ({"latched": "hold"}, "held by the operator"),
    ({"finite": False}, "no finite command"),
    ({"silence": 0.16}, "odometry silent for 0.16 s"),
    ({"connected": False}, "no link to the robot"),
    ({"routed": False}, "does not listen to cmd_vel"),
    ({"silence": 0.16, "source": "pose"}, "pose silent for 0.16 s"),
    ({"silence": 0.16, "refused": "absurd stamp"}, "odometry comes, and is refused: absurd stamp"),
    ({"too_old": True, "age": 0.4, "age_limit": 0.2}, "was 0.40 s old when it came; limit 0.20 s"),
    ({"jumped": reason(Code.POSITION_JUMPED, distance=0.8)}, "odometry jumped by 0.80 m"),
    ({"doubt": reason(Code.POSITION_TOO_FAR, limit=1e6)}, "odometry is beyond"),
    ({"follows": False}, "no two odometry messages within 0.15 s"),
    ({"outside": OUTSIDE}, "outside the bounds: x = 31.20 m, limit 25.00 m"),
    ({"motion": Disagreement(MotionFault.FROZEN, 0.52, 0.0, 0.8)}, "commanded 0.52 m in 0.8 s"),
    ({"motion": Disagreement(MotionFault.TURN, 0.5, 0.0, 0.8)}, "turned 0.00 rad"),
    ({"motion": Disagreement(MotionFault.SPEEDS, 0.1, -0.1, 0.8)}, "its speeds say -0.10 m"),
    ({"motion": Disagreement(MotionFault.SPEEDS, 0.1, -0.1, 0.8), "probe_blocked": True}, "no room to probe"),
    ({"motion": Disagreement(MotionFault.CARRIED, 0.0, 0.1, 0.8)}, "moved without command"),
    ({"motion": Disagreement(MotionFault.TURNED, 0.0, 0.5, 0.8)}, "turned without command"),
    ({"scan_silence": 0.7, "scan_limit": 0.6}, "range scan silent for 0.70 s"),
    ({"scan_silence": 0.7, "scan_limit": 0.6, "scan_refused": "absurd stamp"}, SCAN_REFUSED),
    ({"scan_doubt": reason(Code.SCAN_BLIND, value=0.5, limit=0.15)}, "range scan has range_min 0.5 m"),
    ({"rival": True}, "another agent commands this robot"),
    ({"mission": "0123abcd", "other_missions": {"robot1": "89ef4567"}}, OTHER_MISSION),
    ({"sight_doubt": SEARCHING}, "its range scans do not show robot2 yet: 3 of 5 scans"),
    ({"relative_doubt": LATE}, "robot3 was 1.00 s old when it came"),
    ({"unanswered": {"robot3": Unanswered(3.0, 0.5), "robot4": Unanswered(-7.2, 1.5)}}, UNANSWERED),
    ({"beat_silence": LEADER_TIMEOUT_SECONDS + 0.2}, "order is 1.2 s old"),
    ({"order": RUN.model_copy(update={"mode": "hold"})}, "held by the leader"),
    ({"beat_silence": 1.1, "unsigned": UNSIGNED}, UNSIGNED),
    ({"followed": 0, "neighbours": GONE}, f"{NONE}; silent: robot1 0.40 s"),
    ({"followed": 0, "neighbours": GONE, "leaderless": True}, "silent: robot1 0.40 s"),
    (
        {"followed": 0, "neighbours": {**GONE, "robot2": 0.02}, "not_followed": ("robot2",)},
        f"{NONE}; silent: robot1 0.40 s; unavailable: robot2",
    ),
    (
        {"followed": 0, "not_followed": ("robot1",), "beyond": ("robot1",)},
        f"{NONE}; outside the bounds: robot1",
    ),
]
WAIT: list[tuple[dict[str, Any], str]] = [
    ({"silence": NEVER}, "no odometry yet"),
    ({"silence": NEVER, "refused": "absurd stamp"}, "odometry comes, and is refused: absurd stamp"),
    ({"frozen": 3.2}, "this process was frozen for 3.2 s"),
    ({"scan_silence": NEVER}, "no range scan yet"),
    ({"scan_silence": NEVER, "scan_refused": "absurd stamp"}, SCAN_REFUSED),
    ({"order": None}, "no order from the leader yet"),
]
STOP: list[tuple[dict[str, Any], str]] = [
    ({"latched": "stop"}, "stopped by the operator"),
    ({"order": RUN.model_copy(update={"mode": "stop"})}, "stopped by the leader"),
]
DOUBTS = [
    (doubt, state, words)
    for state, rows in ((AgentState.HOLD, HOLD), (AgentState.WAITING, WAIT), (AgentState.STOP, STOP))
    for doubt, words in rows
]
SHARED = {Code.NO_ORDER, Code.STOPPED_BY_LEADER, Code.HELD_BY_LEADER}
"""Reasons that concern the whole team; so does a lack of neighbours while the leader is silent."""


def test_robot_runs_without_any_doubt() -> None:
    assert decide(FINE) == Decision(AgentState.RUN, Reason(Code.RUNNING), own=False, probes=False)
    assert decide(FINE._replace(refused="a repeated message", scan_refused="too late")) == decide(FINE)


@pytest.mark.parametrize(("doubt", "state", "words"), DOUBTS)
def test_each_doubt_gives_its_state_and_reason(doubt: dict[str, Any], state: AgentState, words: str) -> None:
    facts = FINE._replace(**doubt)
    decision = decide(facts)
    assert decision.state is state
    assert words in str(decision.reason)
    assert decision.own is not (decision.reason.code in SHARED or facts.leaderless)
    assert decide(facts._replace(latched="stop")).reason == Reason(Code.STOPPED_BY_OPERATOR)


def test_every_failsafe_row_is_reached_by_a_doubt() -> None:
    reached = {
        next(i for i, row in enumerate(TABLE) if row.applies(FINE._replace(**d))) for d, _, _ in DOUBTS
    }
    assert reached == set(range(len(TABLE) - 1))
    assert [row.state for row in TABLE].index(AgentState.RUN) == len(TABLE) - 1
