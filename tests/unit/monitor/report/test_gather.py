"""What a report gathers from a recording: errors, delays, losses, leader terms, and the verdict."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.mission.file import parse, read
from formation.monitor import core
from formation.monitor.metrics.snapshot import Snapshot
from formation.monitor.report import summary, tables
from formation.monitor.report.gather import Run
from formation.monitor.report.leader_terms import LeaderTerm, LeaderTerms, overlaps
from formation.monitor.report.parts import View
from formation.monitor.report.summary import notices, verdict
from formation.monitor.report.thin import Curves, Extremes, Magnitude, Quantiles, Samples
from formation.protocol import json_message
from formation.protocol.attachment import Ballot
from formation.ros2.messages import Text
from formation.topics import BALLOT, CMD_VEL, POSITION
from formation.wire import Sample
from tests.support.monitored import EPOCH, Fleet, command, sample_of, status, with_standbys
from tests.support.recordings import START, coming_in, gathered, record, run_of, talk

SET_AT = 14.0
"""When the clock is set [s], before the formation has settled."""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return run_of(tmp_path_factory.mktemp("run"), talk(Fleet(away=coming_in), 12.0))


def test_settling_time_and_final_error_match_the_monitor(tmp_path: Path, run: Run) -> None:
    reported = record(tmp_path / "run.mcap", talk(Fleet(away=coming_in), 12.0))
    found = gathered(tmp_path / "run.mcap").snapshot
    assert reported.settled_at is not None
    assert found.settled_at == pytest.approx(reported.settled_at, abs=1e-6)
    for name in ("final_error", "converged", "missed", "rejected"):
        assert getattr(found, name) == getattr(reported, name)
    assert abs(run.story.elapsed_excess) < 1e-3
    assert not [notice for notice in summary.notices(run) if "clock" in notice]


def with_one_clock(step: float) -> list[Sample]:
    """Positions, with the stamps of a clock that all share and that is set by `step` [s] at `SET_AT`."""
    before = Fleet(away=coming_in)
    result = before.positions(START, SET_AT)
    after = Fleet(away=coming_in, epoch=EPOCH + step, beat=before.beat)
    result += after.positions(SET_AT + 0.001, START + 12.0)
    late = [sample._replace(arrived=sample.arrived + 0.002) for sample in result]
    return sorted(late, key=lambda sample: sample.arrived)


def recorded_with_clock_set(path: Path, step: float) -> tuple[Snapshot, Run, list[str]]:
    """What the monitor knows at the end, the run of its recording, and the notices about clocks."""
    reported = record(path, with_one_clock(step), clock_set=lambda time: step * (time > SET_AT))
    run = gathered(path)
    return reported, run, [notice for notice in notices(run) if "system clock" in notice]


@pytest.mark.parametrize("step", [-900.0, -60.0, -3.0, -0.3, 3.0, 3600.0])
def test_set_clock_leaves_all_figures_and_is_noticed(tmp_path: Path, step: float) -> None:
    reported, run, found = recorded_with_clock_set(tmp_path / "run.mcap", step)
    assert run.snapshot.settled_at == pytest.approx(reported.settled_at, abs=1e-5)
    for name in ("final_error", "converged", "missed", "rejected"):
        assert getattr(run.snapshot, name) == getattr(reported, name)
    assert run.duration == pytest.approx(12.0, abs=0.1)
    assert max(key.gap or 0.0 for key in run.keys if key.topic == "position") < 0.1
    assert run.formation.time[-1] == pytest.approx(12.0, abs=0.2)
    (event,) = (one for one in run.story.events if one.kind == "clock")
    assert event.at - run.start == pytest.approx(SET_AT - START, abs=0.1)
    (notice,) = found
    assert f"was set by {step:+.3f} s at" in notice


@pytest.mark.parametrize(
    ("step", "notice", "off"), [(-60.0, "was set by -59.9", 0.05), (60.0, "off by up to 60.0 s", 61.0)]
)
def test_set_clock_is_noticed_without_its_event(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: float, notice: str, off: float
) -> None:
    monkeypatch.setattr(core, "MIN_CLOCK_STEP", math.inf)  # as of a version without the event
    reported, run, found = recorded_with_clock_set(tmp_path / "run.mcap", step)
    assert notice in " ".join(found)
    assert (run.snapshot.converged, run.snapshot.rejected) == (True, reported.rejected if step < 0.0 else {})
    assert run.snapshot.settled_at == pytest.approx(reported.settled_at, abs=off)


def test_rms_and_maximum_cover_whole_and_settled_run(run: Run) -> None:
    whole, after = run.error.whole, run.error.after
    # nine edges; robots that are off alike do not count: only the two edges to the leader do
    first = 2.0 * abs(coming_in("robot2", START))
    assert whole.maximum == pytest.approx(first, rel=0.05)
    assert after.maximum is not None
    assert after.maximum < run.mission.settled <= 1.1 * after.maximum
    rms = math.sqrt(first**2 / (2.0 * math.log(2.0) * 12.0))  # of an error that halves every second
    assert whole.rms == pytest.approx(rms, rel=0.05)
    maxima = {name: run.robots[name].error.whole.maximum for name in ("robot2", "robot4")}
    assert maxima["robot2"] == pytest.approx(first / 2.0, rel=0.05)
    assert maxima["robot4"] == pytest.approx(0.0, abs=1e-3)  # a curved path, interpolated


def test_heading_errors_and_true_error_come_from_ground_truth(run: Run) -> None:
    assert run.truth
    assert run.robots["robot2"].heading.whole.rms == pytest.approx(0.1, abs=1e-6)
    # the truth of a turned robot has its control point elsewhere
    assert run.true_error.final is not None


def test_report_notes_missing_ground_truth(tmp_path: Path) -> None:
    run = run_of(tmp_path, talk(Fleet(away=coming_in), 4.0, truth=False))
    assert not run.truth
    assert run.true_error.whole.count == 0
    assert run.true_error.final is None
    assert any("No ground truth" in notice for notice in summary.notices(run))


def commands(run: Run, robot: str) -> int:
    return next(key.count for key in run.keys if key.key == f"{robot}/cmd_vel")


def test_delays_come_from_stamps_and_answers_from_odometry(run: Run) -> None:
    assert run.delays["position"].median == pytest.approx(0.002, abs=1e-5)
    assert run.delays["odom"].median == pytest.approx(0.003, abs=1e-5)
    assert "cmd_vel" not in run.delays  # a Twist has no stamp
    assert run.answers["robot3"].median == pytest.approx(0.002, abs=1e-5)
    assert run.answers["robot3"].count == commands(run, "robot3")


def test_command_without_odometry_is_not_timed(tmp_path: Path) -> None:
    run = run_of(tmp_path, [*talk(Fleet(), 2.0), command("robot2", START + 2.5, 0.0, 0.0)])
    assert commands(run, "robot2") == run.answers["robot2"].count + 1


def test_saturation_is_the_share_of_commands_at_the_limit(tmp_path: Path) -> None:
    nearly = 0.95 * parse(read("six_robots")[0], "a test").robots["robot2"].max_speed
    result = [command("robot2", START + 0.05 * i, 1.5 if i < 30 else nearly, -1.5) for i in range(120)]
    run = run_of(tmp_path, result)
    assert run.robots["robot2"].saturated == (0.25, 1.0)
    assert run.robots["robot3"].saturated == (None, None)


def test_gap_without_commands_interrupts_the_line(tmp_path: Path) -> None:
    result = [command("robot2", START + 0.05 * i + (2.0 if i > 20 else 0.0), 0.2, 0.1) for i in range(40)]
    run = run_of(tmp_path, result)
    assert [bool(gap) for gap in np.isnan(run.commands["robot2"].low[:, 0])] == [i == 21 for i in range(41)]


def test_robot_centres_are_offset_from_control_points(run: Run) -> None:
    apart = np.abs(run.paths.points - run.paths.centres)
    offsets = [run.mission.robots[name].control_point_offset for name in run.mission.followers]
    assert apart[-1] == pytest.approx([0.0, *offsets])


def test_silence_of_all_robots_at_end_is_no_loss(tmp_path: Path) -> None:
    run = run_of(tmp_path, [*talk(Fleet(), 3.0), command("robot2", START + 8.0, 0.0, 0.0)])
    assert summary.lost_robots(run.keys) == []


def test_robot_lost_midway_makes_final_error_unknown(tmp_path: Path) -> None:
    samples = talk(Fleet(away=coming_in), 12.0)
    reported = record(
        tmp_path / "run.mcap", [s for s in samples if s.arrived < START + 6.0 or "robot5" not in s.key]
    )
    run = gathered(tmp_path / "run.mcap")
    assert reported.settled_at is run.snapshot.settled_at is run.snapshot.final_error is None
    assert run.known
    ((lost, at),) = summary.lost_robots(run.keys)
    assert lost == "robot5"
    assert at == pytest.approx(6.0, abs=0.1)
    assert "robot5" in " ".join(summary.notices(run))
    assert ("lost", "robot5") in {(event.kind, event.robot) for event in run.story.events}
    numbers = {item.name: item.value for item in summary.items(run)}
    assert (numbers["formation_error"], numbers["formation_error_true"]) == (None, None)
    assert View.of([run]).until > 11.0  # an unsettled run is shown to its end
    way = run.paths.points[run.paths.time > 7.0]
    assert np.isnan(way[:, 4]).all()
    assert np.isfinite(way[:, 3]).all()


def test_other_values_are_known_without_formation_error(tmp_path: Path) -> None:
    samples = talk(Fleet(away=coming_in), 4.0)
    run = run_of(tmp_path, [sample for sample in samples if not sample.key.startswith("robot5")])
    assert not run.known
    assert run.snapshot.settled_at is None
    assert run.robots["robot2"].error.whole.count > 10
    assert np.isfinite(run.paths.points[:, 1]).any()
    assert "never known" in summary.verdict(run)
    assert "Never received: robot5" in " ".join(summary.notices(run))


def test_empty_recording_gives_a_run_and_a_verdict(tmp_path: Path) -> None:
    run = run_of(tmp_path, [])
    assert not run.known
    assert summary.verdict(run) in {
        "Nothing was recorded.",
        "The formation error was never known: positions of some robot are missing.",
    }


def test_cut_recording_is_read_up_to_the_cut(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    record(path, talk(Fleet(away=coming_in), 12.0))
    whole = gathered(path)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    run = gathered(path)
    assert run.recording.condition().is_cut
    assert 0 < run.messages < whole.messages
    assert run.error.whole.maximum == whole.error.whole.maximum
    assert any("cut" in notice for notice in summary.notices(run))


def test_story_contains_orders_and_events_with_times(tmp_path: Path) -> None:
    fleet = Fleet(wants=lambda time: {"shape": "wedge"} if time > START + 3.0 else {})
    run = run_of(tmp_path, talk(fleet, 6.0))
    orders = [(order.mode, order.motion.shape) for order in run.story.orders]
    assert orders == [("run", "hexagon"), ("run", "wedge")]
    assert run.story.orders[1].at - run.start == pytest.approx(3.0, abs=0.3)
    assert {"joined", "order"} <= {event.kind for event in run.story.events}


def test_rejected_messages_are_counted_and_excluded_from_delays(tmp_path: Path) -> None:
    result = talk(Fleet(), 2.0)
    keys = (POSITION.key("robot2"), CMD_VEL.key("robot2"), POSITION.key("robot3"))
    ahead = Fleet().position("robot3", START + 8.0)  # ahead of time
    bad = [*(Sample(key, b"rubbish", None, 0.0) for key in keys[:2]), ahead]
    bad = [one._replace(arrived=result[40 + n].arrived + 1e-4) for n, one in enumerate(bad)]
    run = run_of(tmp_path, sorted([*result, *bad], key=lambda sample: sample.arrived))
    assert [one.rejected for key in keys for one in run.keys if one.key == key] == [1, 1, 1]
    assert sum(run.snapshot.rejected.values()) == 3
    assert run.delays["position"].count == sum(key.startswith("position", 7) for key, *_ in result)


def test_longest_silence_of_key_is_found_with_time(tmp_path: Path) -> None:
    silent = [
        sample
        for sample in talk(Fleet(), 6.0)
        if sample.key != POSITION.key("robot3") or not START + 2.0 < sample.arrived < START + 2.8
    ]
    key = next(key for key in run_of(tmp_path, silent).keys if key.key == POSITION.key("robot3"))
    assert key.gap == pytest.approx(0.83, abs=0.06)
    assert key.gap_at == pytest.approx(2.0, abs=0.1)
    assert key.missed == 16
    assert key.rate is not None
    assert key.rate < 20.0


def test_run_has_the_recorded_law(tmp_path: Path) -> None:
    assert run_of(tmp_path, talk(Fleet(), 1.0), law="paper").mission.law.kind == "paper"


FIRST, SECOND, AGAIN = 64 * 10, 64 * 20 + 1, 64 * 30
MISSION = with_standbys()
STANDBYS = "\n[standbys.spare1]\n[standbys.spare2]\n"


def leading(
    term: int, start: float, end: float, *, late: float = 0.0, publisher_id: str = "leader"
) -> list[Sample]:
    """Positions of a leader from `start` to `end`, received `late` [s] after they were sent."""
    fleet = Fleet(MISSION, term=term)
    samples = [fleet.position("robot1", time) for time in fleet.times("robot1", start, end)]
    return [
        one._replace(
            attachment=(one.attachment or b"").replace(b'"leader', b'"' + publisher_id.encode()),
            arrived=one.arrived + late,
        )
        for one in samples
    ]


def found_terms(samples: Iterable[Sample]) -> list[LeaderTerm]:
    found = LeaderTerms(MISSION)
    for sample in sorted(samples, key=lambda sample: sample.arrived):
        found.process_sample(sample, sample.arrived + EPOCH)
    return found.all


def ballot(name: str, term: int, number: int, time: float, candidacy: str = "leader") -> Sample:
    what = Ballot.model_validate({"term": term, "number": number, "candidacy": candidacy})
    return sample_of(BALLOT.key(name), Text(json_message.encode(what).decode()), time)


def test_leader_terms_without_overlap_are_found_with_gaps() -> None:
    leader_terms = found_terms(
        [*leading(FIRST, 10.0, 12.0), *leading(SECOND, 12.9, 15.0), *leading(AGAIN, 15.3, 16.0)]
    )
    terms = [("robot1", FIRST), ("spare1", SECOND), ("robot1", AGAIN)]
    assert [(one.name, one.term) for one in leader_terms] == terms
    assert [one.positions for one in leader_terms] == [41, 43, 15]
    assert not overlaps(leader_terms)
    first, second, third = (one.published for one in leader_terms)
    assert (first.end, second.begin) == pytest.approx((EPOCH + 12.0, EPOCH + 12.9))
    assert third.begin - second.end == pytest.approx(0.3, abs=0.051)


@pytest.mark.parametrize(
    "others",
    [
        [*leading(SECOND, 12.5, 15.0), *leading(FIRST, 14.0, 14.01)],
        leading(FIRST, 11.0, 13.0, publisher_id="double"),
    ],
    ids=["a single late message of the former leader", "two processes in one term"],
)
def test_late_message_or_second_process_is_found_as_overlap(others: list[Sample]) -> None:
    assert len(overlaps(found_terms([*leading(FIRST, 10.0, 12.0), *others]))) == 1


def test_leader_overlapping_its_successor_is_found() -> None:
    leader_terms = found_terms([*leading(FIRST, 10.0, 13.5), *leading(SECOND, 12.9, 15.0)])
    (both,) = overlaps(leader_terms)
    assert (both.former.name, both.latter.name) == ("robot1", "spare1")
    assert both.span.end - both.span.begin == pytest.approx(0.6, abs=0.051)


def test_delayed_messages_of_a_former_leader_are_no_overlap() -> None:
    leader_terms = found_terms([*leading(FIRST, 10.0, 12.0, late=0.8), *leading(SECOND, 12.5, 15.0)])
    assert not overlaps(leader_terms)
    assert leader_terms[0].received.end > leader_terms[1].received.begin


def test_leader_without_positions_is_known_by_ballots() -> None:
    ballots = [ballot("spare1", SECOND, n, 13.0 + n / 10) for n in range(10)]
    (one,) = found_terms(ballots)
    assert (one.name, one.positions, one.ballots) == ("spare1", 0, 10)
    assert one.published.end < one.published.begin  # no position was received
    former, latter = found_terms([*leading(FIRST, 10.0, 13.5), *ballots])
    assert latter.received.begin < former.received.end


def test_ballots_for_votes_are_no_leader_term() -> None:
    ballots = [ballot("spare1", SECOND, n, 11.0 + n / 10, "candidate") for n in range(10)]
    assert [one.name for one in found_terms([*leading(FIRST, 10.0, 13.0), *ballots])] == ["robot1"]


def test_invalid_messages_create_no_leader_term() -> None:
    position = Sample("robot1/position", b"\0\1\0\0", b'{"publisher_id":"x"', 11.0)
    assert not found_terms([position, sample_of(BALLOT.key("spare1"), Text("[]"), 12.0)])


@given(
    st.lists(
        st.tuples(st.floats(0.1, 3.0), st.floats(-0.5, 1.0).filter(lambda gap: abs(gap) > 0.06)),
        min_size=1, max_size=6,
    )
)  # fmt: skip
def test_overlaps_are_found_exactly_if_terms_overlap(
    leader_terms: list[tuple[float, float]],
) -> None:
    samples, begin, clash, ended = list[Sample](), 10.0, False, 0.0
    for number, (lasts, gap) in enumerate(leader_terms):
        words = leading(64 * (number + 1), begin, begin + lasts)
        clash = clash or words[0].arrived <= ended
        ended = max(ended, words[-1].arrived)
        samples += words
        begin = max(begin + lasts + gap, begin + 0.001)
    assert bool(overlaps(found_terms(samples))) == clash


def test_report_shows_failover_and_robot_states(tmp_path: Path) -> None:
    fleet = Fleet(MISSION, term=FIRST)
    words = [one for one in talk(fleet, 4.0) if one.key != "robot1/position"]
    words += leading(FIRST, 10.0, 11.5, late=0.002) + leading(SECOND, 12.4, 14.0, late=0.002)
    words += [status(name, 10.0 + n / 2, "standby", "") for name in MISSION.standbys for n in range(8)]
    run = run_of(tmp_path, sorted(words, key=lambda one: one.arrived), read("six_robots")[0] + STANDBYS)
    assert [one.name for one in run.leader_terms] == ["robot1", "spare1"]
    table = tables.leader_terms(run)
    assert [row[0] for row in table.rows] == ["robot1", "spare1"]
    assert table.rows[1][3] == "0.9 s"
    assert {row[-1] for row in table.rows} == {"yes"}
    assert [row[-1] for row in tables.orders(run).rows] == ["robot1", "spare1"]
    assert any(one.kind == "leader" and one.robot == "spare1" for one in run.story.events)
    assert not any("at once" in notice for notice in notices(run))
    ran = {name: one.seconds["run"] for name, one in run.activities.items()}
    assert ran == pytest.approx(dict.fromkeys(MISSION.followers, 4.0), abs=0.4)


def test_first_notice_names_two_leaders_at_once(tmp_path: Path) -> None:
    fleet = Fleet(MISSION, term=FIRST)
    words = [*talk(fleet, 3.0), *leading(SECOND, 11.02, 13.0, late=0.002)]
    run = run_of(tmp_path, sorted(words, key=lambda one: one.arrived), read("six_robots")[0] + STANDBYS)
    assert next(iter(notices(run))).startswith("Two leaders at once: robot1 and spare1, for 2.0 s")


def test_report_without_standbys_has_no_leader_terms(tmp_path: Path) -> None:
    assert not tables.leader_terms(run_of(tmp_path, talk(Fleet(), 2.0))).rows


def test_verdict_of_just_settled_run_names_the_rule() -> None:
    snapshot = SimpleNamespace(final_error=0.01, settled_at=4.5, converged=False)
    run: Any = SimpleNamespace(
        mission=SimpleNamespace(settled=0.05), messages=1, known=True, snapshot=snapshot
    )
    assert verdict(run).startswith("Just settled: under ")
    assert verdict(run).endswith("; converged means under it for at least 2 s.")
    snapshot.converged = True
    assert verdict(run).startswith("Converged: ")


@pytest.mark.parametrize(
    ("formed", "why"),
    [
        (True, "the formation error was not under 5 cm at the end"),
        (False, "a shape transition was under way at the end"),
    ],
)
def test_verdict_of_unsettled_run_says_why(formed: bool, why: str) -> None:
    snapshot = SimpleNamespace(final_error=0.01, settled_at=None, converged=False, formed=formed)
    run: Any = SimpleNamespace(
        mission=SimpleNamespace(settled=0.05), messages=1, known=True, snapshot=snapshot
    )
    assert verdict(run) == f"Not settled: {why}."


def thinned(rows: Iterable[Sequence[float]], **how: Any) -> Curves:
    """Curves of rows that come once a second."""
    rows = list(rows)
    series = Extremes(len(rows[0]), **how)
    for i, row in enumerate(rows):
        series.add(float(i), row)
    return series.curves(0.0)


def test_short_series_is_kept_unchanged() -> None:
    time, values = thinned((i, -i) for i in range(100)).line(1)
    assert time == pytest.approx(np.arange(100.0))
    assert values == pytest.approx(-np.arange(100.0))


def test_long_series_is_thinned_but_keeps_beginning_and_peak() -> None:
    values = np.sin(np.arange(100_000.0))
    values[54_321] = 1000.0
    curves = thinned(values[:, None], max_rows=64, head=16)
    assert len(curves.time) <= 64
    assert (curves.time[:16] == np.arange(16.0)).all()
    assert (curves.low[:16, 0] == values[:16]).all()
    assert np.nanmax(curves.high) == 1000.0
    assert (np.diff(curves.time) > 0.0).all()
    peak = curves.time[np.argmax(curves.high[:, 0])]
    assert peak <= 54_321 <= peak + 2.0 * np.diff(curves.time).max()


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=400))
def test_thinning_keeps_the_extremes(values: list[float]) -> None:
    curves = thinned([(value,) for value in values], max_rows=8, head=2)
    assert (curves.low.min(), curves.high.max()) == (min(values), max(values))
    time, line = curves.line(0)
    assert len(time) == len(line) <= 16
    assert {min(values), max(values)} <= set(line)


def test_thinning_ignores_unknown_values() -> None:
    assert (thinned([(1.0,), (np.nan,)] * 32, max_rows=4, head=0).low == 1.0).all()


def test_thinned_vectors_are_original_samples() -> None:
    ways = Samples(1, max_rows=32, head=8)
    for i in range(5_000):
        ways.add(float(i), (complex(i, -i),))
    time, rows = ways.rows(0.0)
    assert len(time) <= 32
    assert (rows[:, 0].real == time).all()


def test_thinned_percentiles_stay_accurate_and_keep_maximum() -> None:
    spread = Quantiles(max_values=1024)
    for i in range(100_000):
        spread.add(i / 100_000)
    spread.add(7.0)
    assert spread.percentile(0.5) == pytest.approx(0.5, abs=0.01)
    assert spread.percentile(0.99) == pytest.approx(0.99, abs=0.01)
    assert (spread.count, spread.maximum) == (100_001, 7.0)
    assert len(spread._values) <= 1024


def test_rms_and_maximum_use_magnitudes() -> None:
    size = Magnitude()
    assert (size.rms, size.maximum, Quantiles().percentile(0.5)) == (None, None, None)
    size.add(3.0)
    size.add(-4.0)
    assert size.rms == pytest.approx(12.5**0.5)
    assert size.maximum == 4.0
