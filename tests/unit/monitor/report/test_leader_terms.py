from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.mission.file import read
from formation.monitor.report import tables
from formation.monitor.report.leader_terms import LeaderTerm, LeaderTerms, overlaps
from formation.monitor.report.summary import notices
from formation.protocol import order
from formation.protocol.order import Ballot
from formation.ros2.messages import Text
from formation.topics import BALLOT
from formation.wire import Sample
from tests.support.monitored import EPOCH, Fleet, sample_of, status, with_standbys
from tests.support.recordings import gathered, record, talk

FIRST, SECOND, AGAIN = 64 * 10, 64 * 20 + 1, 64 * 30
MISSION = with_standbys()
STANDBYS = "\n[standbys.spare1]\n[standbys.spare2]\n"


def leading(
    term: int, start: float, end: float, *, late: float = 0.0, publisher_id: str = ""
) -> list[Sample]:
    """What a leader says from one moment to another; it is received `late` after that."""
    fleet = Fleet(MISSION, term=term)
    samples = [fleet.position("robot1", time) for time in fleet.times("robot1", start, end)]
    if publisher_id:
        samples = [
            one._replace(attachment=(one.attachment or b"").replace(b'"leader', b'"' + publisher_id.encode()))
            for one in samples
        ]
    return [one._replace(arrived=one.arrived + late) for one in samples]


def received(samples: Iterable[Sample]) -> list[LeaderTerm]:
    inbox = sorted(samples, key=lambda sample: sample.arrived)
    found = LeaderTerms(MISSION)
    for sample in inbox:
        found.process_sample(sample, sample.arrived + EPOCH)
    return found.all


def ballot(name: str, term: int, number: int, time: float, candidacy: str = "leader") -> Sample:
    what = Ballot.model_validate({"term": term, "number": number, "candidacy": candidacy})
    return sample_of(BALLOT.key(name), Text(order.encode(what).decode()), time)


def test_no_candidate_leads_between_two_leader_terms() -> None:
    leader_terms = received(
        [*leading(FIRST, 10.0, 12.0), *leading(SECOND, 12.9, 15.0), *leading(AGAIN, 15.3, 16.0)]
    )
    assert [(one.name, one.term) for one in leader_terms] == [
        ("robot1", FIRST),
        ("spare1", SECOND),
        ("robot1", AGAIN),
    ]
    assert [one.positions for one in leader_terms] == [41, 43, 15]
    assert not overlaps(leader_terms)
    first, second, third = (one.published for one in leader_terms)
    assert (first.end, second.begin) == pytest.approx((EPOCH + 12.0, EPOCH + 12.9))
    assert third.begin - second.end == pytest.approx(0.3, abs=0.051)


def test_a_leader_that_goes_on_beside_its_successor_is_found() -> None:
    leader_terms = received([*leading(FIRST, 10.0, 13.5), *leading(SECOND, 12.9, 15.0)])
    (both,) = overlaps(leader_terms)
    assert (both.former.name, both.latter.name) == ("robot1", "spare1")
    assert both.span.end - both.span.begin == pytest.approx(0.6, abs=0.051)


def test_single_late_message_of_former_leader_is_found() -> None:
    assert overlaps(
        received([*leading(FIRST, 10.0, 12.0), *leading(SECOND, 12.5, 15.0), *leading(FIRST, 14.0, 14.01)])
    )


def test_two_processes_in_one_term_are_two_leaders() -> None:
    leader_terms = received([*leading(FIRST, 10.0, 12.0), *leading(FIRST, 11.0, 13.0, publisher_id="double")])
    assert len(overlaps(leader_terms)) == 1


def test_delayed_messages_are_no_second_leader_by_stamp() -> None:
    leader_terms = received([*leading(FIRST, 10.0, 12.0, late=0.8), *leading(SECOND, 12.5, 15.0)])
    assert not overlaps(leader_terms)
    assert leader_terms[0].received.end > leader_terms[1].received.begin


def test_leader_without_positions_is_known_by_ballots() -> None:
    ballots = [ballot("spare1", SECOND, n, 13.0 + n / 10) for n in range(10)]
    (one,) = received(ballots)
    assert (one.name, one.positions, one.ballots) == ("spare1", 0, 10)
    assert one.published.end < one.published.begin  # none has come with a position
    former, latter = received([*leading(FIRST, 10.0, 13.5), *ballots])
    assert latter.received.begin < former.received.end


def test_candidate_without_lease_does_not_lead() -> None:
    wishes = [ballot("spare1", SECOND, n, 11.0 + n / 10, "candidate") for n in range(10)]
    assert [one.name for one in received([*leading(FIRST, 10.0, 13.0), *wishes])] == ["robot1"]


def test_invalid_messages_create_no_leader() -> None:
    rubbish = [
        Sample("robot1/position", b"\0\1\0\0", b'{"publisher_id":"x"', 11.0),
        sample_of(BALLOT.key("spare1"), Text("[]"), 12.0),
    ]
    assert not received(rubbish)


@given(
    st.lists(
        st.tuples(st.floats(0.1, 3.0), st.floats(-0.5, 1.0).filter(lambda gap: abs(gap) > 0.06)),
        min_size=1, max_size=6,
    )
)  # fmt: skip
def test_there_are_overlaps_exactly_where_one_begins_before_another_has_ended(
    leader_terms: list[tuple[float, float]],
) -> None:
    samples, begin, clash, ended = list[Sample](), 10.0, False, 0.0
    for number, (lasts, gap) in enumerate(leader_terms):
        words = leading(64 * (number + 1), begin, begin + lasts)
        clash = clash or words[0].arrived <= ended
        ended = max(ended, words[-1].arrived)
        samples += words
        begin = max(begin + lasts + gap, begin + 0.001)
    assert bool(overlaps(received(samples))) == clash


def test_report_shows_failover_and_robot_states(tmp_path: Path) -> None:
    fleet = Fleet(MISSION, term=FIRST)
    words = [one for one in talk(fleet, 4.0) if one.key != "robot1/position"]
    words += leading(FIRST, 10.0, 11.5, late=0.002) + leading(SECOND, 12.4, 14.0, late=0.002)
    words += [status(name, 10.0 + n / 2, "standby", "") for name in MISSION.standbys for n in range(8)]
    record(
        tmp_path / "run.mcap", sorted(words, key=lambda one: one.arrived), read("six_robots")[0] + STANDBYS
    )
    run = gathered(tmp_path / "run.mcap")
    assert [one.name for one in run.leader_terms] == ["robot1", "spare1"]
    table = tables.leader_terms(run)
    assert [row[0] for row in table.rows] == ["robot1", "spare1"]
    assert table.rows[1][3] == "0.9 s"
    assert {row[-1] for row in table.rows} == {"yes"}
    assert [row[-1] for row in tables.orders(run).rows] == ["robot1", "spare1"]
    assert any(one.kind == "leader" and one.robot == "spare1" for one in run.events)
    assert not any("at once" in notice for notice in notices(run, cut=False))
    ran = {name: one.seconds["run"] for name, one in run.doings.items()}
    assert ran == pytest.approx(dict.fromkeys(MISSION.followers, 4.0), abs=0.4)


def test_a_report_says_first_if_two_led_at_once(tmp_path: Path) -> None:
    fleet = Fleet(MISSION, term=FIRST)
    words = [*talk(fleet, 3.0), *leading(SECOND, 11.02, 13.0, late=0.002)]
    record(
        tmp_path / "run.mcap", sorted(words, key=lambda one: one.arrived), read("six_robots")[0] + STANDBYS
    )
    run = gathered(tmp_path / "run.mcap")
    assert next(iter(notices(run, cut=False))).startswith("Two leaders at once: robot1 and spare1, for 2.0 s")


def test_a_report_without_standbys_has_no_table_of_leaders(tmp_path: Path) -> None:
    record(tmp_path / "run.mcap", talk(Fleet(), 2.0))
    assert not tables.leader_terms(gathered(tmp_path / "run.mcap")).rows
