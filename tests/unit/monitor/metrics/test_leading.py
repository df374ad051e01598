from __future__ import annotations

import json
import re

import pytest

from formation.monitor.core import Monitor
from formation.monitor.metrics.event import Event
from formation.monitor.metrics.keys import watched
from formation.monitor.metrics.orders import leader_of
from formation.monitor.metrics.snapshot import Snapshot
from formation.monitor.metrics.words import line
from formation.protocol import order
from formation.protocol.order import Ballot, Slots
from formation.protocol.status import MotionFault
from formation.ros2.messages import Diagnostics, Status, Text
from formation.topics import BALLOT, POSITION, ROUTE, STATUS
from formation.wire import Sample
from tests.support.monitored import EPOCH, Fleet, now, receive, sample_of, status, with_standbys
from tests.unit.monitor.metrics.test_events import Watcher, of

FIRST, SECOND = 64 * 10, 64 * 20 + 1
"""Terms of the leader's own process, and of the first standby."""


class Team(Watcher):
    """Six robots with two standbys: a robot's process says how it is twice a second, until it is killed."""

    def __init__(self) -> None:
        super().__init__(Fleet(with_standbys(), term=FIRST))
        self.alive = {"robot1": "run", "spare1": "standby", "spare2": "standby"}

    def go_on(self, until: float, *, without: str = "") -> list[Event]:
        words = [
            status(name, at / 10, state, "")
            for name, state in self.alive.items()
            for at in range(round(10 * self.at) + 1, round(10 * until), 4)
        ]
        return self.drive(until, *words, without=without)

    def fail_over(self) -> list[Event]:
        """robot1's process is killed; spare1 leads after 0.9 s."""
        del self.alive["robot1"]
        decoded = self.go_on(self.at + 0.9, without="robot1")
        self.fleet.term, self.alive["spare1"] = SECOND, "run"
        return decoded + self.go_on(self.at + 5.0)

    @property
    def seen(self) -> Snapshot:
        return self.monitor.metrics.snapshot(now(self.at))


def test_leader_is_known_by_the_term_of_orders() -> None:
    mission = with_standbys()
    assert [leader_of(mission, 640 + rank) for rank in range(4)] == ["robot1", "spare1", "spare2", ""]
    assert leader_of(Fleet().mission, 643) == "robot1"


def test_without_standbys_no_candidates_are_shown() -> None:
    one = Watcher(Fleet())
    one.drive(15.0)
    snapshot = one.monitor.metrics.snapshot(now(15.0))
    assert (snapshot.leads, snapshot.candidates) == ("robot1", {})
    assert not of(one.reported, "leader")
    assert "leads" not in line(snapshot)


def test_everything_that_standbys_say_is_listened_to_and_status_comes_last() -> None:
    mission = with_standbys()
    keys = [one.key for one in watched(mission)]
    for name in mission.candidates:
        assert {BALLOT.key(name), ROUTE.key(name), STATUS.key(name)} <= set(keys)
        assert keys.index(BALLOT.key(name)) < min(
            keys.index(STATUS.key(other)) for other in mission.candidates
        )
    assert POSITION.key("robot1") in keys
    assert f"spare1/{POSITION.name}" not in keys


def test_leading_standby_is_reported_with_time_without_leader() -> None:
    team = Team()
    assert [(event.robot, event.text) for event in of(team.go_on(15.0), "leader")] == [("robot1", "leads")]
    (change,) = of(team.fail_over(), "leader")
    assert (change.robot, change.level) == ("spare1", 30)
    assert change.text.startswith("leads from here on, robot1 was silent for 0.9")
    assert team.seen.leads == "spare1"
    assert "spare1 leads, robot1 could not" in line(team.seen)


def test_leader_is_present_while_any_candidate_leads() -> None:
    team = Team()
    team.go_on(15.0)
    decoded = team.fail_over()
    assert [event.robot for event in of(decoded, "lost")] == ["robot1"]
    (lost,) = of(decoded, "lost")
    assert (lost.level, lost.text.startswith("could not take over")) == (30, True)
    leader = team.seen.robots["robot1"]
    assert leader.state == "run"
    assert leader.age is not None
    assert leader.age < 0.1
    assert team.seen.formation_error == pytest.approx(0.0, abs=1e-6)


def test_returning_leader_becomes_standby() -> None:
    team = Team()
    team.go_on(15.0)
    team.fail_over()
    team.alive["robot1"] = "standby"
    (event,) = [event for event in team.go_on(25.0) if event.robot == "robot1"]
    assert (event.kind, event.level, event.text) == ("standby", 20, "stands by")
    states = {name: one.state for name, one in team.seen.candidates.items()}
    assert states == {"robot1": "standby", "spare1": "leads", "spare2": "standby"}
    assert team.seen.robots["robot1"].state == "run"


def test_dead_standby_is_lost_with_warning_only() -> None:
    team = Team()
    team.go_on(15.0)
    del team.alive["spare2"]
    (lost,) = of(team.go_on(20.0), "lost")
    assert (lost.robot, lost.level) == ("spare2", 30)
    assert team.seen.candidates["spare2"].state == "silent"
    assert team.seen.converged
    assert set(team.seen.robots) == set(team.fleet.mission.names)


def test_without_leader_none_is_named() -> None:
    team = Team()
    team.go_on(15.0)
    del team.alive["robot1"]
    decoded = team.go_on(18.0, without="robot1")
    assert team.seen.leads is None
    assert "no leader" in line(team.seen)
    assert [(event.robot, event.level) for event in of(decoded, "lost")] == [("robot1", 40)]


def test_a_former_leaders_positions_are_not_shown_and_are_nobodys_error() -> None:
    team = Team()
    team.go_on(15.0)
    team.fail_over()
    metrics, at = team.monitor.metrics, team.at
    former = Fleet(team.fleet.mission, term=FIRST, away=lambda *_: 5.0 + 0j, beat=1000)
    receive(metrics, [former.position("robot1", at + 0.01)])
    for time in (at + 0.02, at + 0.05):
        receive(metrics, [team.fleet.position(name, time) for name in team.fleet.mission.names])
    snapshot = metrics.snapshot(now(at + 0.05))
    assert snapshot.formation_error == pytest.approx(0.0, abs=1e-6)
    assert snapshot.leads == "spare1"
    assert list(snapshot.rejected) == ["robot1/position: of an earlier term: another leads by now"]


def test_new_leader_with_slow_clock_is_shown_soon() -> None:
    fleet = Fleet(with_standbys(), term=FIRST)
    monitor = Monitor(fleet.mission)
    receive(monitor.metrics, fleet.positions(10.0, 12.0))
    fleet.term = SECOND
    later = fleet.positions(12.9, 13.5, without="robot1")
    later += [fleet.position("robot1", time, clock=-5.0) for time in fleet.times("robot1", 12.9, 13.5)]
    receive(monitor.metrics, sorted(later, key=lambda sample: sample.arrived))
    snapshot = monitor.metrics.snapshot(now(13.5))
    assert snapshot.leads == "spare1"
    assert snapshot.formation_error == pytest.approx(0.0, abs=1e-3)
    assert not snapshot.rejected


def test_a_term_from_the_day_after_tomorrow_counts_for_nothing() -> None:
    fleet = Fleet(with_standbys(), term=int((EPOCH + 2e5) * 1e9))
    monitor = Monitor(fleet.mission)
    receive(monitor.metrics, [fleet.position("robot1", 10.0)])
    assert monitor.metrics.order is None


def test_ballots_are_checked_like_everything_else() -> None:
    monitor = Monitor(with_standbys())
    good = Ballot(term=SECOND, number=1, candidacy="candidate", mission=with_standbys().tag)
    receive(monitor.metrics, [sample_of(BALLOT.key("spare1"), Text(order.encode(good).decode()), 10.0)])
    assert not monitor.metrics.rejections.by_reason
    receive(monitor.metrics, [sample_of(BALLOT.key("spare2"), Text(order.encode(good).decode()), 10.1)])
    receive(monitor.metrics, [sample_of(BALLOT.key("robot1"), Text("{}"), 10.2)])
    assert monitor.metrics.rejections.by_key == {BALLOT.key("spare2"): 1, BALLOT.key("robot1"): 1}


def test_whatever_an_operator_changes_of_the_order_is_an_event() -> None:
    one = Watcher(Fleet())
    wishes: dict[float, dict[str, object]] = {
        12.0: {"shape": "wedge"},
        14.0: {"rotation": 0.7853981633974483},
        16.0: {"scale": 1.5},
        18.0: {"route": "c4f2"},
        20.0: {"mode": "hold"},
        22.0: {"mode": "stop"},
    }

    def wants(time: float) -> dict[str, object]:
        return {key: value for at, wish in wishes.items() if time >= at for key, value in wish.items()}

    one.fleet.wants = wants
    decoded = [event.text for event in of(one.drive(24.0), "order")]
    assert decoded == [
        "the leader orders run, shape hexagon",
        "the leader orders run, shape wedge",
        "the leader orders run, shape wedge, turned by 45°",
        "the leader orders run, shape wedge, turned by 45°, 1.5 times as large",
        "the leader orders run, shape wedge, turned by 45°, 1.5 times as large, on route c4f2",
        "the leader orders hold, shape wedge, turned by 45°, 1.5 times as large, on route c4f2",
        "the leader orders stop, shape wedge, turned by 45°, 1.5 times as large, on route c4f2",
    ]


def test_a_shape_that_has_moved_is_reported_as_formed() -> None:
    one = Watcher(Fleet())

    def wants(time: float) -> dict[str, object]:
        part = min(max((time - 15.0) / 3.0, 0.0), 1.0)
        if not 0.0 < part < 1.0:
            return {"shape": "wedge"} if part else {}
        return {"shape": "wedge", "slots": Slots(mix={"hexagon": 1.0 - part, "wedge": part})}

    one.fleet.wants = wants
    (formed,) = of(one.drive(25.0), "formed")
    assert formed.text.startswith("the slots are where they are wanted, 3.")
    kinds = [event.kind for event in one.reported if event.kind in {"settled", "unsettled"}]
    assert kinds == ["settled", "unsettled", "settled"]
    (unsettled,) = of(one.reported, "unsettled")
    assert (unsettled.level, unsettled.text) == (20, "another shape is on its way")
    assert re.search(
        r"since 8\.\d s, 3\.[01] s after what was ordered last$", of(one.reported, "settled")[-1].text
    )


def with_words(robot: str, time: float, values: dict[str, object], fleet: Fleet) -> Sample:
    decoded = order.PositionAttachment.model_validate({"publisher_id": "a", "count": 1, **values})
    return fleet.position(robot, time)._replace(attachment=order.encode(decoded))


def test_coming_in_at_the_start_is_no_warning() -> None:
    one = Watcher(Fleet())
    before = with_words("robot3", 10.001, {"unavailable": True}, one.fleet)
    (unavailable,) = of(one.run_until(10.1, [before]), "unavailable")
    assert (unavailable.robot, unavailable.level) == ("robot3", 20)


def test_unavailable_and_following_again_are_events() -> None:
    one = Watcher(Fleet())
    one.drive(11.0)
    (unavailable,) = of(
        one.drive(12.0, with_words("robot3", 11.501, {"unavailable": True}, one.fleet)), "unavailable"
    )
    assert (unavailable.robot, unavailable.level) == ("robot3", 30)
    assert one.monitor.metrics.snapshot(now(12.0)).robots["robot3"].unavailable
    (follows,) = of(one.drive(13.0, with_words("robot3", 12.501, {"count": 2}, one.fleet)), "follows")
    assert (follows.robot, follows.level) == ("robot3", 20)


def test_restarted_process_is_reported_once() -> None:
    one = Watcher(Fleet())
    publisher_ids = ["a", "a", "b", "a", "b"]
    samples = [
        with_words("robot3", 11.001 + 0.5 * n, {"publisher_id": publisher_id, "count": n}, one.fleet)
        for n, publisher_id in enumerate(publisher_ids)
    ]
    (restarted,) = of(one.drive(15.0, *samples), "restarted")
    assert (restarted.robot, restarted.level) == ("robot3", 30)


def saying(robot: str, at: float, requested: str) -> Sample:
    """A leader's status with this under ``requested``."""
    values = {"kind": "leader", "robot": robot, "state": "run", "requests": requested}
    return sample_of(STATUS.key(robot), Diagnostics(at + EPOCH, (Status("", 0, "", "", values),)), at)


def test_operator_request_is_reported_once_with_its_answer() -> None:
    one = Watcher(Fleet(with_standbys()))
    requested = [
        {"do": "shape", "shape": "wedge", "id": "a1", "ok": True, "reason": "in 4.2 s"},
        {"do": "speed", "speed": 9.0, "degrees": 45.0, "id": "b2", "ok": False, "reason": "at most 1.5 m/s"},
    ]
    later = [
        *requested,
        {"do": "stop", "id": "a1", "ok": True, "reason": ""},
    ]  # an id is of one kind of order
    samples = [saying("robot1", 11.0 + n / 2, json.dumps(requested if n < 3 else later)) for n in range(6)]
    samples += [saying("spare1", 14.2, json.dumps(later[2:]))]
    decoded = [(event.robot, event.level, event.text) for event in of(one.drive(16.0, *samples), "requested")]
    assert decoded == [
        ("robot1", 20, "shape wedge; it obeys: in 4.2 s"),
        ("robot1", 30, "speed 9 45; it refuses: at most 1.5 m/s"),
        ("robot1", 20, "stop; it obeys"),
        ("spare1", 20, "stop; it obeys"),
    ]


@pytest.mark.parametrize(
    "said_to_be",
    ["", "5", "[[]]", "[" * 5000, '[{"do": "dance", "id": "x"}]', '[{"do": "stop"}]', '{"do": "stop"}'],
)
def test_what_is_no_list_of_requests_tells_nothing(said_to_be: str) -> None:
    one = Watcher(Fleet())
    assert not of(one.drive(13.0, saying("robot1", 11.0, said_to_be)), "requested")


def test_waiting_leader_names_the_robots() -> None:
    one = Watcher(Fleet())
    awaited = {11.0: (), 12.0: ("robot4", "robot5"), 13.0: ("robot5",), 14.0: ()}
    samples = [status("robot1", at, "run", waits_for=names) for at, names in awaited.items()]
    decoded = [(event.level, event.text) for event in of(one.drive(16.0, *samples), "waits")]
    assert decoded == [(30, "the leader waits for robot4, robot5"), (20, "the leader waits no longer")]


def test_following_a_non_neighbour_is_reported_as_fallback() -> None:
    one = Watcher(Fleet())
    guides = {11.0: ("robot2", "robot3"), 12.0: ("robot1",), 13.0: ("robot2",)}
    samples = [status("robot4", at, "run", follows=names) for at, names in guides.items()]
    decoded = [(event.robot, event.level, event.text) for event in of(one.drive(14.0, *samples), "fallback")]
    assert decoded == [
        ("robot4", 30, "none of its own neighbours is left, it follows robot1"),
        ("robot4", 20, "its own neighbours are back"),
    ]


def test_robot_not_moving_as_commanded_is_reported() -> None:
    one = Watcher(Fleet())
    samples = [status("robot4", 11.0, "run", motion=MotionFault.FROZEN), status("robot4", 12.0, "run")]
    decoded = [(event.level, event.text) for event in of(one.drive(13.0, *samples), "stuck")]
    assert decoded == [(30, "does not move as commanded"), (20, "moves again")]
