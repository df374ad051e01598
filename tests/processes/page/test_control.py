"""The page's operator, with a team in memory: the latches of the agents, and a leader."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from formation.agent.safety.latch import Latch
from formation.mission.file import load
from formation.monitor.metrics.event import INFO, WARNING, Event
from formation.monitor.web import control
from formation.monitor.web.control import Operator, Overruled
from formation.protocol.json_message import decode
from formation.protocol.order import Mode
from formation.protocol.request import OperatorRequest
from formation.stability import intent
from formation.topics import ORDER
from formation.transport.bus_config import BusError
from formation.transport.mailbox import Question, Reply
from tests.unit.leader.leading import leading

SIX = load("six_robots")


class Team:
    """Passes each request to the leader and the latches, robot by robot, in the order of sending."""

    def __init__(self) -> None:
        self.leader = leading(SIX)
        self.latches = {name: Latch(name) for name in SIX.followers}
        self.away: set[str] = set()
        self.received: list[str] = []
        self.closed = False
        self.changed = threading.Condition()

    def question(self, key: str, payload: bytes, _: float) -> Question:
        question = Question()
        with self.changed:
            self.received.append(payload.decode())
            robots = SIX.names if key.startswith("*") else (key.partition("/")[0],)
            for name in robots:
                if name not in self.away:
                    question.replies.append(Reply(ORDER.key(name), self._ask(name, payload), 1.5))
            question.end()
            self.changed.notify_all()
        return question

    @property
    def sent(self) -> list[str]:
        """What the requests received so far ask for, in the order of sending."""
        return [decode(OperatorRequest, payload.encode()).do for payload in self.received]

    def close(self) -> None:
        self.closed = True

    def leader_mode(self) -> Mode:
        return self.leader.mode

    def latch_modes(self) -> dict[str, Mode | None]:
        return {name: latch.mode for name, latch in self.latches.items()}

    def wait_for(self, what: Callable[[], bool]) -> None:
        with self.changed:
            assert self.changed.wait_for(what, 20.0)

    def _ask(self, name: str, payload: bytes) -> bytes:
        if name == SIX.leader:
            return self.leader.request(payload, 0.0)
        return self.latches[name].request(decode(OperatorRequest, payload), 0.0, self.leader.mode)


@pytest.fixture
def team() -> Team:
    return Team()


@pytest.fixture
def events() -> list[Event]:
    return []


@pytest.fixture
def operator(team: Team, events: list[Event], monkeypatch: pytest.MonkeyPatch) -> Operator:
    monkeypatch.setattr(control, "UNSEEN_STOP_TIME", 0.0)  # orders right after a stop are not refused
    monkeypatch.setattr(control, "DOUBLE_CLICK_TIME", 0.0)
    monkeypatch.setattr(control, "ANSWER_TIMEOUT_SECONDS", 20.0)  # robots return within it on a busy machine
    return Operator(SIX, team, events.append)


@pytest.fixture
def pages() -> Iterator[ThreadPoolExecutor]:
    with ThreadPoolExecutor(8) as pages:
        yield pages


def start_order(
    pages: ThreadPoolExecutor, operator: Operator, team: Team, do: str, **how: Any
) -> Future[dict[str, Any]]:
    """Give an order in another thread, and wait until it is being sent, whatever else is sent meanwhile.

    A release and a run begin with a query.
    """
    first = "query" if do in {"release", "run"} else do
    before = team.sent.count(first)
    given = pages.submit(operator.order, do, **how)
    team.wait_for(lambda: team.sent.count(first) > before)
    return given


def test_stop_reaches_all_robots_and_each_acknowledges(
    operator: Operator, team: Team, events: list[Event]
) -> None:
    report = operator.order("stop")
    assert [one["robot"] for one in report["acknowledged"]] == list(SIX.names)
    assert {one["mode"] for one in report["acknowledged"]} == {"stop"}
    assert (report["do"], report["missing"], team.leader.mode) == ("stop", [], "stop")
    assert set(team.latch_modes().values()) == {"stop"}
    (event,) = events
    assert (event.level, event.robot, event.kind) == (INFO, "", "operator")
    assert event.text.startswith("stop: 6 of 6 obey, slowest ")


def test_orders_change_modes_and_shape(operator: Operator, team: Team) -> None:
    assert [one["robot"] for one in operator.order("hold")["acknowledged"]] == list(SIX.names)
    assert (team.leader_mode(), set(team.latch_modes().values())) == ("hold", {"hold"})
    operator.order("run")
    assert (team.leader_mode(), set(team.latch_modes().values())) == ("run", {None})
    report = operator.order("shape", shape="wedge")
    assert (report["shape"], team.leader.plan.shape_transition.ordered.shape) == ("wedge", "wedge")
    operator.order("stop")
    report = operator.order("release")
    assert report["advice"] == ["all robots hold until you order run"]
    assert (team.leader_mode(), set(team.latch_modes().values())) == ("hold", {"hold"})
    operator.order("run")
    assert (team.leader_mode(), set(team.latch_modes().values())) == ("run", {None})


def test_held_pad_does_not_move_next_leader(operator: Operator, team: Team) -> None:
    def drive(forward: float) -> None:
        answer = operator.drive(driver="page-1", forward=forward, turn=0.0, token=tokens[-1])
        tokens.append(answer["token"])

    tokens, team.leader = [0], leading(SIX, publisher_id="first")
    drive(1.0)
    drive(1.0)
    assert team.leader.plan.driven
    team.away = {SIX.leader}
    drive(1.0)  # no leader answers
    team.away = set()
    order, team.leader = team.leader.plan.order(1, 5, "run"), leading(SIX, publisher_id="next")
    team.leader.plan.restore(order)
    for _ in range(3):
        drive(1.0)
        assert not team.leader.plan.driver.live(0.0)


def test_unreachable_robots_are_named_in_report_and_event(
    team: Team, events: list[Event], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(control, "ANSWER_TIMEOUT_SECONDS", 0.1)
    team.away = {"robot3", "robot6"}
    report = Operator(SIX, team, events.append, why="because").order("stop")
    assert (report["missing"], report["why"]) == (["robot3", "robot6"], "because")
    assert events[0].level == WARNING
    assert "4 of 6 obey" in events[0].text
    assert "no answer from robot3, robot6" in events[0].text


def test_refusal_is_reported_as_event_with_reason(
    operator: Operator, team: Team, events: list[Event]
) -> None:
    team.leader.request(b'{"do":"stop"}', 0.0)
    assert [one["robot"] for one in operator.order("run")["refused"]] == [SIX.leader]
    assert f"{SIX.leader} refuses: stopped: release it first" in events[0].text


def test_stop_is_sent_while_hold_awaits_its_answer(
    operator: Operator, team: Team, pages: ThreadPoolExecutor
) -> None:
    team.away = {SIX.leader}
    hold = start_order(pages, operator, team, "hold")
    team.away = set()
    before = time.monotonic()
    operator.order("stop")
    assert time.monotonic() - before < control.ANSWER_TIMEOUT_SECONDS / 2
    hold.result(20.0)
    assert set(team.latch_modes().values()) == {"stop"}


def test_release_is_not_repeated_after_newer_stop(
    operator: Operator, team: Team, pages: ThreadPoolExecutor
) -> None:
    operator.order("stop")
    team.away = {"robot6"}
    release = start_order(pages, operator, team, "release")
    team.wait_for(lambda: "release" in team.sent)  # not only the query before it
    stop = start_order(pages, operator, team, "stop")
    team.away = set()
    assert stop.result(20.0)["missing"] == []
    assert "robot6" in release.result(20.0)["missing"]
    assert set(team.latch_modes().values()) == {"stop"}
    newer_stop = team.sent.index("stop", team.sent.index("release"))
    assert "release" not in team.sent[newer_stop:]


@pytest.mark.parametrize(
    ("rest", "do", "what"),
    [("stop", "release", {}), ("hold", "run", {}), ("hold", "shape", {"shape": "wedge"})],
)
def test_motion_is_refused_while_stop_or_hold_is_being_sent(
    operator: Operator, team: Team, pages: ThreadPoolExecutor, rest: str, do: str, what: dict[str, Any]
) -> None:
    team.away = {"robot6"}
    given = start_order(pages, operator, team, rest)
    with pytest.raises(Overruled):
        operator.order(do, **what)
    with pytest.raises(Overruled):
        operator.drive(driver="page-1", forward=0.5, turn=0.0, token=0)
    assert operator.drive(driver="page-1", forward=0.0, turn=0.0, token=0)["mode"] == rest
    team.away = set()
    assert given.result(20.0)["missing"] == []
    assert set(team.latch_modes().values()) == {rest}


def test_double_click_sends_release_once(
    team: Team, events: list[Event], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(control, "UNSEEN_STOP_TIME", 0.0)
    monkeypatch.setattr(control, "DOUBLE_CLICK_TIME", 60.0)
    operator = Operator(SIX, team, events.append)
    operator.order("hold")
    operator.order("stop")
    first, second = operator.order("release"), operator.order("release")
    assert first is second
    assert team.leader.mode == "hold"
    assert [event.text.partition(":")[0] for event in events] == ["hold", "stop", "release"]


def test_same_order_of_two_pages_has_one_report(
    team: Team, pages: ThreadPoolExecutor, events: list[Event], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(control, "DOUBLE_CLICK_TIME", 60.0)
    monkeypatch.setattr(control, "ANSWER_TIMEOUT_SECONDS", 20.0)
    operator = Operator(SIX, team, events.append)
    team.away = {SIX.leader}
    first = start_order(pages, operator, team, "run")
    second = pages.submit(operator.order, "run")
    team.away = set()
    assert first.result(20.0) is second.result(20.0)
    assert len(events) == 1


@pytest.mark.parametrize(
    ("do", "shape", "result"),
    [
        ("fly", None, "must be one of hold, run, stop, release, shape"),
        ("shape", "circle", "must be one of hexagon, wedge"),
        ("shape", None, "must be one of hexagon, wedge"),
        ("stop", "wedge", "takes no shape"),
    ],
)
def test_bad_order_is_refused_and_not_sent(
    operator: Operator, team: Team, do: str, shape: str | None, result: str
) -> None:
    with pytest.raises(ValueError, match=result):
        operator.order(do, shape=shape)
    assert team.received == []


def test_each_operator_has_new_token(team: Team, events: list[Event]) -> None:
    tokens = {Operator(SIX, team, events.append).token for _ in range(20)}
    assert len(tokens) == 20
    assert min(map(len, tokens)) >= 43  # 256 bits


def test_missing_configuration_is_named_by_its_flag(tmp_path: Path, events: list[Event]) -> None:
    missing = tmp_path / "operator.json5"
    with pytest.raises(BusError, match=r"^--control-config .*operator\.json5"):
        control.on_the_bus(SIX, events.append, own_file=missing)
    with pytest.raises(BusError, match=r"^--config .*operator\.json5"):
        control.on_the_bus(SIX, events.append, file=missing)


def test_close_ends_pending_order_and_closes_bus(
    operator: Operator, team: Team, pages: ThreadPoolExecutor
) -> None:
    team.away = {"robot6"}
    stop = start_order(pages, operator, team, "stop")
    operator.close()
    assert stop.result(20.0)["missing"] == ["robot6"]
    assert team.closed


def test_second_click_reports_failure_again(
    team: Team, events: list[Event], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: object) -> Question:
        raise OSError("the line is broken")

    monkeypatch.setattr(team, "question", fails)
    operator = Operator(SIX, team, events.append)
    for _ in range(2):
        with pytest.raises(OSError, match="the line is broken"):
            operator.order("hold", click="c")


def test_order_overtaken_by_stop_is_not_sent(
    operator: Operator, team: Team, pages: ThreadPoolExecutor, monkeypatch: pytest.MonkeyPatch
) -> None:
    put_reached, put = threading.Event(), operator._send

    def announced_put(*question: Any) -> Any:
        put_reached.set()
        return put(*question)

    monkeypatch.setattr(operator, "_send", announced_put)
    with operator._lock:
        given, _ = operator._precedence.accept(intent.request_for(SIX, "run"), 0.0)
        run = pages.submit(operator._give, given)  # checks whether it is over, then waits for the lock
        assert put_reached.wait(20.0)
        operator._precedence.accept(intent.request_for(SIX, "stop"), 1.0)
    run.result(20.0)
    assert given.overruled
    assert not team.received
