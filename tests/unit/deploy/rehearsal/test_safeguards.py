"""Rules that each safeguard acts and says so: what breaks them is found, though another has its effect."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from formation.agent.following import orders
from formation.agent.following.publisher import AcceptedPublisher
from formation.agent.following.relative_check import RelativeCheck
from formation.agent.inbox import Wakefulness
from formation.agent.persistence import restore
from formation.agent.pose.motion_check import MotionCheck
from formation.agent.pose.stream import Stream
from formation.agent.safety import failsafe
from formation.agent.safety.scanner import Scanner
from formation.control import avoidance
from formation.control.quantiser import quantise
from formation.control.unicycle import AT_REST
from formation.deploy.rehearsal.bridges import Restarted
from formation.deploy.rehearsal.faults import parse
from formation.deploy.rehearsal.fleet import Fleet
from formation.deploy.rehearsal.power_cut import FailingPath
from formation.deploy.rehearsal.rehearsal import Plan, run
from formation.deploy.rehearsal.rules.received import Newest, OrdersReceived
from formation.leader.cohesion import Cohesion
from formation.leader.plan import TeamMode
from formation.mission.file import load, read
from formation.monitor.recording import part
from formation.protocol.election import Voter
from formation.protocol.order import Order
from formation.protocol.reasons import Code
from formation.protocol.stops import Rest, Result
from formation.ros2.messages import Odometry, decode, encode
from tests.campaigns.defects.plan import MISSIONS

PAIR, POSTS = load("turtlebot3_pair"), load("posts")
TRIO, MEASURED, BLOCKED, PAPER = (
    load(MISSIONS / f"{name}.toml") for name in ("trio", "measured", "blocked", "trio_paper")
)
ORDER = Order(term=64, beat=7, mode="run", shape="line")
LOST = failsafe.Facts(
    latched=None,
    silence=0.0,
    limit=1.0,
    jumped=None,
    order=ORDER,
    beat_silence=9.0,
    neighbours={},
    followed=1,
)


def broken(mission: Any, *faults: str, signed: bool = False) -> set[str]:
    return run(Plan(mission, signed=signed), 0, tuple(parse(one, mission) for one in faults)).broken


def test_robot_that_follows_a_silent_one_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    assert broken(TRIO, "robot1:kill@6+5") == set()
    monkeypatch.setattr(Stream, "fresh", lambda stream, _: stream.state.arrived is not None)
    assert "follow" in broken(TRIO, "robot1:kill@6+5")


def test_robot_that_does_not_name_a_lost_leader_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    assert broken(PAIR, "leader:kill@6+4") == set()
    row = next(one for one in failsafe.TABLE if one.applies(LOST))
    assert row.reason(LOST).code is Code.LEADER_LOST
    monkeypatch.setattr(failsafe, "TABLE", tuple(one for one in failsafe.TABLE if one is not row))
    assert "follow" in broken(PAIR, "leader:kill@6+4")


def test_late_order_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Positions that come as late are refused, but for robots that measure their neighbours."""
    assert broken(MEASURED, "robot1:late=0.5@5+8") == set()
    monkeypatch.setattr("formation.agent.following.orders.Orders._check_late", lambda *_: None)
    assert "orders" in broken(MEASURED, "robot1:late=0.5@5+8")


def test_replayed_order_of_an_earlier_leader_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    faults = "robot1:replay@4+12", "leader:kill@7+9"
    assert broken(TRIO, *faults, signed=True) == set()
    # the later of the voted term and the term in force, which no order may precede
    monkeypatch.setattr(orders, "max", lambda *_: 0, raising=False)
    assert "orders" in broken(TRIO, *faults, signed=True)


def test_order_whose_beat_has_not_risen_is_no_leaders() -> None:
    received = OrdersReceived()
    received.add("robot1/position", ORDER, 1.0)
    received.add("robot1/position", ORDER, 2.0)
    received.add("robot2/position", ORDER.model_copy(update={"beat": 8}), 3.0)
    assert received.risen == set()
    received.add("robot1/position", ORDER.model_copy(update={"beat": 8}), 4.0)
    assert (received.risen, received.rose) == ({64}, 4.0)


def test_quickest_message_counts_for_some_time() -> None:
    newest = Newest().after(1.0, 1.1).after(2.0, 2.5)
    assert (newest.sent, newest.quickest) == pytest.approx((2.0, 0.1))
    assert newest.after(80.0, 80.5).quickest == pytest.approx(0.5)


def test_repeated_position_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    faults = "robot1:again=2@4+10", "robot1:kill@7+4"
    assert broken(TRIO, *faults) == set()
    monkeypatch.setattr(AcceptedPublisher, "_judge", lambda *_: None)
    assert "orders" in broken(TRIO, *faults)


def test_half_a_file_of_stops_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    faults = "robot1:stop@4+8", "robot2:torn@7+2"
    assert broken(TRIO, *faults) == set()
    monkeypatch.setattr(FailingPath, "with_suffix", lambda path, _: path)
    assert "restored" in broken(TRIO, *faults)


def test_robot_that_runs_while_stopped_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    assert broken(PAIR, "robot1:stop@4+5", "robot2:waver@5+2") == set()

    def obeys(rest: Rest, _: Any) -> Result:
        rest.hold = ""
        return Result(ok=True)

    monkeypatch.setattr(Rest, "_run", obeys)
    assert "answer" in broken(PAIR, "robot1:stop@4+5", "robot2:waver@5+2")


@pytest.mark.parametrize(
    ("mission", "fault", "patched", "instead"),
    [
        (PAIR, "robot1:freeze@5+2", (Wakefulness, "step"), lambda *_: False),
        (TRIO, "robot3:speeds=0@6+6", (MotionCheck, "_contradiction"), lambda *_: None),
        (MEASURED, "robot3:relative_frozen@6+6", (RelativeCheck, "saw"), lambda *_, **__: None),
        (POSTS, "robot1:scan_frozen@6+8", (Scanner, "_compare"), lambda *_: None),
    ],
)
def test_fault_that_is_not_named_is_found(
    mission: Any, fault: str, patched: tuple[Any, str], instead: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert broken(mission, fault) == set()
    monkeypatch.setattr(*patched, instead)
    assert "named" in broken(mission, fault)


def test_second_publisher_that_is_not_named_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    assert broken(TRIO, "robot1:second@5+4") == set()
    admit = AcceptedPublisher.admit
    monkeypatch.setattr(AcceptedPublisher, "admit", lambda one, *given: _uncontested(admit, one, *given))
    assert "named" in broken(TRIO, "robot1:second@5+4")


def _uncontested(admit: Any, one: Any, *given: Any) -> None:
    try:
        admit(one, *given)
    finally:
        one.state.contested = float("-inf")


def test_forgotten_vote_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    assert broken(TRIO, "robot1:kill@5+3") == set()
    monkeypatch.setattr(restore.Restorer, "take_saved", lambda *_: restore.Taken(None, ""))
    assert "restored" in broken(TRIO, "robot1:kill@5+3")


def test_old_integral_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    assert broken(PAPER, "robot1:kill@5+6") == set()
    monkeypatch.setattr(restore, "MAX_INTEGRAL_AGE", 60.0)
    assert "restored" in broken(PAPER, "robot1:kill@5+6")


def test_half_written_state_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    assert broken(TRIO, "robot1:torn@5+1") == set()
    monkeypatch.setattr("formation.deploy.rehearsal.fleet.state_in", lambda data: data)
    assert "restored" in broken(TRIO, "robot1:torn@5+1")


def test_vote_of_a_fresh_agent_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    begin = Voter.__init__

    def hasty(voter: Voter, *given: Any, **options: Any) -> None:
        begin(voter, *given, **options)
        voter._quarantine = 0.0

    monkeypatch.setattr(Voter, "__init__", hasty)
    assert "votes" in broken(TRIO, "robot1:kill@5+2")


def test_leader_that_waits_too_long_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    assert broken(TRIO, "robot3:blocked@6+12") == set()
    monkeypatch.setattr(Cohesion, "_given_up", lambda *_: set())
    assert "wait" in broken(TRIO, "robot3:blocked@6+12")


def test_leader_that_does_not_inherit_a_stop_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    killed = [f"{name}:kill@6+2" for name in ("leader", "deputy", "reserve")]
    assert broken(TRIO, "robot1:stop@4+8", *killed) == set()
    monkeypatch.setattr(TeamMode, "inherit_stop", lambda *_: None)
    assert "stop" in broken(TRIO, "robot1:stop@4+8", *killed)


def test_blocked_robots_that_take_no_detour_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    faults = "robot2:kill@0.5", "robot3:kill@0.5"
    assert broken(BLOCKED, *faults) == set()
    monkeypatch.setattr(avoidance, "DEADLOCK_DELAY", 500.0)
    assert "detour" in broken(BLOCKED, *faults)


def test_robots_that_do_not_brake_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    crowd = load(MISSIONS / "crowd.toml")
    monkeypatch.setattr(avoidance, "brake", lambda wanted, *_: wanted)
    monkeypatch.setattr("formation.control.pipeline.brake", lambda wanted, *_: wanted)
    assert "brake" in broken(crowd)


def test_rounding_that_adds_up_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def forgetful(quantiser: Any, wanted: Any, _: Any) -> tuple[Any, Any]:
        rounded: tuple[Any, Any] = honest(quantiser, wanted, AT_REST)
        return rounded

    honest = quantise
    monkeypatch.setattr("formation.control.pipeline.quantise", forgetful)
    assert "steps" in broken(PAIR)


def test_team_without_leader_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Fleet, "start", lambda *_: None)
    assert "led" in broken(PAIR, "leader:kill@6+1")


def test_wrong_index_of_a_recording_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = Plan(PAIR, record=tmp_path / "run.mcap", text=read("turtlebot3_pair")[0])
    append = part.Part.append_packed

    def shifted(one: Any, record: bytes, chunk: Any, shift: int, *given: Any) -> None:
        append(one, record, chunk, 2 * shift + 1, *given)

    monkeypatch.setattr(part.Part, "append_packed", shifted)
    assert run(plan, 0, ()).broken == {"record"}


def test_recorded_times_of_a_wrong_clock_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = Plan(PAIR, record=tmp_path / "run.mcap", text=read("turtlebot3_pair")[0])
    monkeypatch.setattr("formation.deploy.rehearsal.rules.recorded.EPOCH", 0.0)
    assert run(plan, 0, ()).broken == {"record"}


def test_repeated_measurement_that_counts_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    assert broken(PAIR, "robot1:repeat=0.12@4+2") == set()
    monkeypatch.setattr(Stream, "_agree", lambda *_: True)
    assert "named" in broken(PAIR, "robot1:repeat=0.12@4+2")


def test_odometry_that_restarts_counts_from_zero() -> None:
    restarted = Restarted()
    first = restarted.changed(encode(Odometry(1.0, 2 + 1j, 1j, 0.1, 0.0)))
    later = restarted.changed(encode(Odometry(2.0, 2 + 3j, -1 + 0j, 0.1, 0.0)))
    assert decode(Odometry, first).position == pytest.approx(0j)
    assert decode(Odometry, later).position == pytest.approx(2 + 0j)
    assert decode(Odometry, later).heading == pytest.approx(1j)
