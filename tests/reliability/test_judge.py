"""The judge of the campaign: each of its verdicts is held by a trace that is good and by one that is not."""

from __future__ import annotations

import cmath
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from formation.mission_file import load
from tests.reliability import judge
from tests.reliability.judge import Motion
from tests.reliability.seen import Commanded, Floats, Led, Seen
from tests.reliability.soak import Reading, growth
from tests.reliability.verdicts import holders

SIX = load("six_robots")
ROBOT = SIX.robots["robot2"]
FAST, TURN = ROBOT.max_speed, ROBOT.max_turn_rate


def commands(*speeds: float, since: float = 0.0, turn_rate: float = 0.0) -> list[Commanded]:
    """One every 0.05 s, in shares of the speed limit."""
    return [
        Commanded(since + 0.05 * n, share * FAST, turn_rate if share else 0.0)
        for n, share in enumerate(speeds)
    ]


def led(at: float, voice: str = "a", term: int = 1) -> Led:
    return Led(at, 0j, voice, term, "run", tuple(map(complex, SIX.slots())))


def test_the_peak_is_the_largest_share_of_either_limit() -> None:
    assert Motion.of(commands(0.2, 0.9, 0.3), ROBOT).peak == pytest.approx(0.9)
    assert Motion.of(commands(0.2, turn_rate=-1.2 * TURN), ROBOT).peak == pytest.approx(1.2)
    assert Motion.of([], ROBOT).peak == 0.0


def test_a_command_over_a_limit_is_a_fault_and_one_at_it_is_none() -> None:
    assert judge.faults(Motion.of(commands(1.0), ROBOT)) == []
    assert judge.faults(Motion.of(commands(1.001), ROBOT)) == ["a command was 100.1 % of a limit"]


def test_a_command_that_is_no_number_is_over_every_limit() -> None:
    broken = [Commanded(0.0, float("nan"), 0.0)]
    assert judge.faults(Motion.of(broken, ROBOT))


def test_a_jump_is_from_one_command_to_the_next_also_from_rest_and_across_signs() -> None:
    assert Motion.of(commands(0.1, 0.3, 0.4), ROBOT).jump == pytest.approx(0.2)
    assert Motion.of(commands(0.0, 0.7), ROBOT).jump == pytest.approx(0.7)
    assert Motion.of(commands(0.4, -0.4), ROBOT).jump == pytest.approx(0.8)


def test_a_jump_of_more_than_half_a_limit_is_a_fault() -> None:
    assert judge.faults(Motion.of(commands(0.0, 0.49), ROBOT)) == []
    assert judge.faults(Motion.of(commands(0.0, 0.51), ROBOT)) == ["a command jumped by 51 % of a limit"]


def test_a_jump_to_zero_is_the_failsafes_right_and_is_counted() -> None:
    motion = Motion.of(commands(0.9, 0.0, 0.0, 0.3, 0.0), ROBOT)
    assert motion.jump == pytest.approx(0.3)
    assert motion.zeros == 2


def test_a_small_command_is_not_zero() -> None:
    assert Motion.of(commands(0.9, 1e-6), ROBOT).jump > 0.8


@pytest.mark.parametrize(
    ("errors", "expected"),
    [
        ([0.5, 0.1, *[0.01] * 30], 0.10),
        ([0.01] * 30, 0.0),
        ([0.5] * 30, None),
        ([0.01] * 19, None),  # not for long enough
        ([*[0.01] * 10, 0.5, *[0.01] * 30], 0.55),  # it came back once
        ([*[0.01] * 10, float("nan"), *[0.01] * 30], 0.55),  # what is unknown is not small
        ([0.02] * 30, None),
    ],
)
def test_the_error_is_back_from_when_it_stays_small(errors: Sequence[float], expected: float | None) -> None:
    times: Floats = 0.05 * np.arange(len(errors), dtype=np.float64)
    assert judge.settled_at(times, np.array(errors)) == pytest.approx(expected)


def test_a_robot_stood_from_the_first_zero_after_which_nothing_else_came() -> None:
    assert judge.stood(commands(0.5, 0.5, 0.0, 0.0, 0.0), 0.0, 1.0) == pytest.approx(0.10)
    assert judge.stood(commands(0.5, 0.0, 0.5, 0.0, 0.0), 0.0, 1.0) == pytest.approx(0.15)


def test_a_robot_stood_at_once_if_it_was_told_so_before() -> None:
    assert judge.stood(commands(0.5, 0.0), 0.2, 1.0) == 0.0


def test_a_robot_whose_last_command_was_to_drive_never_stood() -> None:
    assert judge.stood(commands(0.5, 0.0, 0.5), 0.0, 1.0) is None
    assert judge.stood(commands(0.5), 0.2, 1.0) is None
    assert judge.stood([], 0.0, 1.0) is None


def test_who_went_on_was_commanded_all_the_time_and_never_to_stand() -> None:
    assert judge.went_on(commands(*[0.5] * 30), 0.0, 1.4)
    assert not judge.went_on(commands(*[0.5] * 10, 0.0, *[0.5] * 19), 0.0, 1.4)
    assert not judge.went_on(commands(*[0.5] * 10), 0.0, 1.4), "it fell silent"
    assert not judge.went_on([*commands(0.5, 0.5), *commands(0.5, 0.5, since=0.9)], 0.0, 0.95), "a gap"
    assert not judge.went_on([], 0.0, 1.0)


def test_one_leader_after_the_other_are_no_rivals() -> None:
    leads = [led(0.0), led(1.0), led(1.5, "b", 2), led(2.0, "b", 2)]
    assert judge.rivals(leads) == []
    assert [reign.voice for reign in judge.reigns(leads)] == ["a", "b"]


def test_two_that_say_so_in_turns_are_rivals_and_so_is_one_that_speaks_again() -> None:
    ((one, other),) = judge.rivals([led(0.0), led(1.0, "b", 2), led(1.1), led(2.0, "b", 2)])
    assert (one.voice, other.voice) == ("a", "b")
    assert judge.rivals([led(0.0), led(1.0, "b", 2), led(3.0)])


def test_one_who_leads_again_in_a_new_term_is_somebody_else() -> None:
    assert judge.rivals([led(0.0), led(1.0), led(2.0, "a2", 3)]) == []


def test_a_takeover_is_the_first_word_of_who_did_not_lead_before() -> None:
    leads = [led(0.0), led(1.0), led(1.1), led(1.8, "b", 2)]
    assert judge.taken_over(leads, 1.05) == pytest.approx(0.75)
    assert judge.taken_over(leads[:-1], 1.05) is None


def driven(astray: complex = 0j, leader_until: float = 2.0) -> Seen:
    """Two seconds at 0.2 m/s with everybody in place, but robot4, which is `astray`."""
    seen, slots = Seen(SIX), SIX.slots()
    for n in range(41):
        at = 0.05 * n
        if at <= leader_until:
            order = {"term": 1, "beat": n, "mode": "run", "shape": "hexagon"}
            seen.take(["lead", at, 0.2 * at, 0.0, {"voice": "a", "count": n, "order": order}])
        for name, slot in zip(SIX.followers, slots[1:], strict=True):
            point = slot + 0.2 * at + (astray if name == "robot4" else 0j)
            centre = point - SIX.robots[name].control_point_offset * cmath.rect(1.0, 0.3)
            seen.take(["truth", at + 0.01, name, centre.real, centre.imag, 0.3])
    return seen


def test_a_team_in_its_places_has_no_error_though_samples_are_of_different_times() -> None:
    seen = driven()
    inner = judge.grid(0.1, 1.9)
    assert seen.errors(inner).max() == pytest.approx(0.0, abs=0.02)  # 0.01 s at 0.2 m/s on each edge's ends
    assert seen.now == pytest.approx(2.01)


def test_the_error_adds_up_the_edges_of_a_robot_that_is_astray() -> None:
    edges = sum("robot4" in (name, other) for name in SIX.names for other in SIX.robots[name].neighbours)
    away = driven(0.3j).errors(np.array([1.0])) - driven().errors(np.array([1.0]))
    assert away == pytest.approx(0.3 * edges, rel=0.05)


def test_a_leader_that_fell_silent_is_where_it_was() -> None:
    assert driven(leader_until=1.0).errors(np.array([2.0])) > 0.15


def test_the_nearest_two_are_found() -> None:
    apart = driven().distances(np.array([1.0]))
    closer = driven(SIX.slot("robot3") - SIX.slot("robot4") + 0.1).distances(np.array([1.0]))
    assert apart == pytest.approx(1.0, abs=0.01)
    assert closer == pytest.approx(0.1, abs=0.01)


def test_a_witness_is_read_on_line_by_line_and_half_a_line_waits(tmp_path: Path) -> None:
    file = tmp_path / "seen.jsonl"
    file.write_text('["command", 1.0, "robot2", 0.5, 0.1]\n["command", 2.0, "rob')
    seen = Seen(SIX, file)
    seen.read_on()
    assert seen.commands["robot2"] == [Commanded(1.0, 0.5, 0.1)]
    with file.open("a") as more:
        more.write('ot2", 0.0, 0.0]\n')
    seen.read_on()
    assert seen.commands["robot2"][1:] == [Commanded(2.0, 0.0, 0.0)]
    seen.close()


def test_what_is_forgotten_leaves_the_last_of_it() -> None:
    seen = driven()
    seen.forget(1.0)
    assert 0.9 < seen.leads[0].at < 1.0
    assert len(seen.places["robot2"]) < 25


def test_who_holds_is_whoever_has_nobody_left_and_whoever_follows_only_such() -> None:
    assert holders(SIX, ["robot3"]) == set()  # robot4 has robot2, robot5 has robot4
    assert holders(SIX, ["robot4", "robot3"]) == {"robot5", "robot6"}


def test_growth_is_from_the_fifth_minute_on_and_of_old_processes_only() -> None:
    young = [Reading(age, 100) for age in (0.0, 100.0, 400.0)]
    old = [Reading(0.0, 50), Reading(310.0, 100), Reading(900.0, 107)]
    assert growth(young) is None
    assert growth(old) == pytest.approx(1.07)
