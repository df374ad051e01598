from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation import order
from formation.mission_file import read
from formation.order import Ballot
from formation.ros2.messages import Text
from formation.topics import BALLOT
from formation.wire import Sample
from monitor.recording.reader import Recorded
from monitor.report import happened
from monitor.report.reigns import Reign, Span, at, gaps, overlaps, who_led
from monitor.report.summary import notices
from tests.monitor.fleet import EPOCH, Fleet, said, status, with_standbys
from tests.monitor.report.recordings import gathered, record, talk

FIRST, SECOND, AGAIN = 64 * 10, 64 * 20 + 1, 64 * 30
MISSION = with_standbys()
STANDBYS = "\n[standbys.spare1]\n[standbys.spare2]\n"


def leading(term: int, start: float, end: float, *, late: float = 0.0, voice: str = "") -> list[Sample]:
    """What a leader says from one moment to another; it is heard `late` after that."""
    fleet = Fleet(MISSION, term=term)
    samples = [fleet.position("robot1", time) for time in fleet.times("robot1", start, end)]
    if voice:
        samples = [
            one._replace(attachment=(one.attachment or b"").replace(b'"leader', b'"' + voice.encode()))
            for one in samples
        ]
    return [one._replace(arrived=one.arrived + late) for one in samples]


def heard(samples: Iterable[Sample]) -> list[Reign]:
    inbox = sorted(samples, key=lambda sample: sample.arrived)
    walls = [sample.arrived + EPOCH for sample in inbox]
    return who_led(
        MISSION,
        [Recorded(s._replace(arrived=w), w, round(w * 1e9)) for s, w in zip(inbox, walls, strict=True)],
    )


def ballot(name: str, term: int, number: int, time: float, standing: str = "leader") -> Sample:
    what = Ballot.model_validate({"term": term, "number": number, "standing": standing})
    return said(BALLOT.key(name), Text(order.encode(what).decode()), time)


def test_each_term_is_a_reign_and_between_two_nobody_leads() -> None:
    reigns = heard([*leading(FIRST, 10.0, 12.0), *leading(SECOND, 12.9, 15.0), *leading(AGAIN, 15.3, 16.0)])
    assert [(one.name, one.term) for one in reigns] == [
        ("robot1", FIRST),
        ("spare1", SECOND),
        ("robot1", AGAIN),
    ]
    assert [one.positions for one in reigns] == [41, 43, 15]
    assert not overlaps(reigns)
    first, second = gaps(reigns)
    assert first == pytest.approx(Span(EPOCH + 12.0, EPOCH + 12.9))
    assert second.end - second.begin == pytest.approx(0.3, abs=0.051)


def test_who_led_at_a_moment_can_be_asked_for_every_moment() -> None:
    reigns = heard([*leading(FIRST, 10.0, 12.0), *leading(SECOND, 12.9, 15.0)])
    names = [[one.name for one in at(reigns, EPOCH + time)] for time in (9.9, 11.0, 12.5, 13.0, 15.1)]
    assert names == [[], ["robot1"], [], ["spare1"], []]


def test_a_leader_that_goes_on_beside_its_successor_is_found() -> None:
    reigns = heard([*leading(FIRST, 10.0, 13.5), *leading(SECOND, 12.9, 15.0)])
    (both,) = overlaps(reigns)
    assert (both.former.name, both.latter.name) == ("robot1", "spare1")
    assert both.span.end - both.span.begin == pytest.approx(0.6, abs=0.051)
    assert [one.name for one in at(reigns, EPOCH + 13.0)] == ["robot1", "spare1"]


def test_one_last_word_of_a_former_leader_is_found_however_late_it_is() -> None:
    assert overlaps(
        heard([*leading(FIRST, 10.0, 12.0), *leading(SECOND, 12.5, 15.0), *leading(FIRST, 14.0, 14.01)])
    )


def test_two_processes_in_one_term_are_two_leaders() -> None:
    reigns = heard([*leading(FIRST, 10.0, 12.0), *leading(FIRST, 11.0, 13.0, voice="double")])
    assert len(overlaps(reigns)) == 1


def test_what_is_only_long_on_its_way_is_no_second_leader_by_the_stamps() -> None:
    reigns = heard([*leading(FIRST, 10.0, 12.0, late=0.8), *leading(SECOND, 12.5, 15.0)])
    assert not overlaps(reigns)
    assert overlaps(reigns, "heard")


def test_a_leader_whose_positions_nobody_heard_is_known_by_its_ballots() -> None:
    ballots = [ballot("spare1", SECOND, n, 13.0 + n / 10) for n in range(10)]
    (one,) = heard(ballots)
    assert (one.name, one.positions, one.ballots) == ("spare1", 0, 10)
    assert not list(gaps([one]))
    assert overlaps(heard([*leading(FIRST, 10.0, 13.5), *ballots]), "heard")


def test_who_only_stands_for_election_does_not_lead() -> None:
    wishes = [ballot("spare1", SECOND, n, 11.0 + n / 10, "candidate") for n in range(10)]
    assert [one.name for one in heard([*leading(FIRST, 10.0, 13.0), *wishes])] == ["robot1"]


def test_rubbish_leads_nobody() -> None:
    rubbish = [
        Sample("robot1/position", b"\0\1\0\0", b'{"voice":"x"', 11.0),
        said(BALLOT.key("spare1"), Text("[]"), 12.0),
    ]
    assert not heard(rubbish)


@given(
    st.lists(
        st.tuples(st.floats(0.1, 3.0), st.floats(-0.5, 1.0).filter(lambda gap: abs(gap) > 0.06)),
        min_size=1, max_size=6,
    )
)  # fmt: skip
def test_there_are_overlaps_exactly_where_one_begins_before_another_has_ended(
    reigns: list[tuple[float, float]],
) -> None:
    samples, begin, clash, ended = list[Sample](), 10.0, False, 0.0
    for number, (lasts, gap) in enumerate(reigns):
        words = leading(64 * (number + 1), begin, begin + lasts)
        clash = clash or words[0].arrived <= ended
        ended = max(ended, words[-1].arrived)
        samples += words
        begin = max(begin + lasts + gap, begin + 0.001)
    assert bool(overlaps(heard(samples))) == clash


def test_a_report_tells_of_a_failover_and_of_what_everybody_did(tmp_path: Path) -> None:
    fleet = Fleet(MISSION, term=FIRST)
    words = [one for one in talk(fleet, 4.0) if one.key != "robot1/position"]
    words += leading(FIRST, 10.0, 11.5, late=0.002) + leading(SECOND, 12.4, 14.0, late=0.002)
    words += [status(name, 10.0 + n / 2, "standby", "") for name in MISSION.standbys for n in range(8)]
    record(
        tmp_path / "run.mcap", sorted(words, key=lambda one: one.arrived), read("six_robots")[0] + STANDBYS
    )
    run = gathered(tmp_path / "run.mcap")
    assert [one.name for one in run.reigns] == ["robot1", "spare1"]
    table = happened.reigns(run)
    assert [row[0] for row in table.rows] == ["robot1", "spare1"]
    assert table.rows[1][3] == "0.9 s"
    assert {row[-1] for row in table.rows} == {"yes"}
    assert [row[-1] for row in happened.orders(run).rows] == ["robot1", "spare1"]
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
    assert next(iter(notices(run, cut=False))).startswith("Two led at once: robot1 and spare1, for 2.0 s")


def test_a_report_without_standbys_has_no_table_of_leaders(tmp_path: Path) -> None:
    record(tmp_path / "run.mcap", talk(Fleet(), 2.0))
    assert not happened.reigns(gathered(tmp_path / "run.mcap")).rows
