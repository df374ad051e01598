"""The judge of the reliability campaign: each verdict for a good and for a bad trace."""

from __future__ import annotations

import cmath
from collections.abc import Sequence

import numpy as np
import pytest

from formation.mission.file import load
from tests.campaigns.reliability import judge
from tests.campaigns.reliability.judge import Motion
from tests.campaigns.reliability.seen import Commanded, Floats, Led, Seen
from tests.campaigns.reliability.trial import holders

SIX = load("six_robots")
ROBOT = SIX.robots["robot2"]
FAST, TURN = ROBOT.max_speed, ROBOT.max_turn_rate


def commands(*speeds: float, since: float = 0.0, turn_rate: float = 0.0) -> list[Commanded]:
    """Commands every 0.05 s, in shares of the speed limit."""
    return [
        Commanded(since + 0.05 * n, share * FAST, turn_rate if share else 0.0)
        for n, share in enumerate(speeds)
    ]


def led(at: float, publisher_id: str = "a", term: int = 1) -> Led:
    return Led(at, 0j, publisher_id, term, "run", tuple(map(complex, SIX.slots())))


@pytest.mark.parametrize(
    ("given", "peak", "jump", "zeros"),
    [
        ([], 0.0, 0.0, 0),
        (commands(0.2, 0.9, 0.3), 0.9, 0.7, 0),
        (commands(0.1, 0.3, 0.4), 0.4, 0.2, 0),
        (commands(0.0, 0.7), 0.7, 0.7, 0),
        (commands(0.4, -0.4), 0.4, 0.8, 0),
        (commands(0.9, 0.0, 0.0, 0.3, 0.0), 0.9, 0.3, 2),  # jumps to zero are legal, and counted
        (commands(0.9, 1e-6), 0.9, 0.9, 0),
    ],
)
def test_motion_has_peak_and_largest_jump(
    given: Sequence[Commanded], peak: float, jump: float, zeros: int
) -> None:
    motion = Motion.of(given, ROBOT)
    assert (motion.peak, motion.jump) == pytest.approx((peak, jump), abs=1e-5)
    assert motion.zeros == zeros


def test_peak_counts_turn_rate_as_well() -> None:
    assert Motion.of(commands(0.2, turn_rate=-1.2 * TURN), ROBOT).peak == pytest.approx(1.2)


@pytest.mark.parametrize(
    ("given", "faults"),
    [
        (commands(1.0), []),
        (commands(1.001), ["a command was 100.1 % of a limit"]),
        (commands(0.0, 0.49), []),
        (commands(0.0, 0.51), ["a command jumped by 51 % of a limit"]),
    ],
)
def test_only_commands_above_a_limit_and_large_jumps_are_faults(
    given: Sequence[Commanded], faults: list[str]
) -> None:
    assert judge.faults(Motion.of(given, ROBOT)) == faults


def test_nan_command_is_a_fault() -> None:
    assert judge.faults(Motion.of([Commanded(0.0, float("nan"), 0.0)], ROBOT))


@pytest.mark.parametrize(
    ("errors", "expected"),
    [
        ([0.5, 0.1, *[0.01] * 30], 0.10),
        ([0.01] * 30, 0.0),
        ([0.5] * 30, None),
        ([0.01] * 19, None),  # not for long enough
        ([*[0.01] * 10, 0.5, *[0.01] * 30], 0.55),  # a large error in between
        ([*[0.01] * 10, float("nan"), *[0.01] * 30], 0.55),  # an unknown error is not small
        ([0.02] * 30, None),
    ],
)
def test_settled_at_is_when_error_stays_small(errors: Sequence[float], expected: float | None) -> None:
    times: Floats = 0.05 * np.arange(len(errors), dtype=np.float64)
    assert judge.settled_at(times, np.array(errors)) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("given", "since", "expected"),
    [
        (commands(0.5, 0.5, 0.0, 0.0, 0.0), 0.0, 0.10),
        (commands(0.5, 0.0, 0.5, 0.0, 0.0), 0.0, 0.15),
        (commands(0.5, 0.0), 0.2, 0.0),  # it stood before `since`
        (commands(0.5, 0.0, 0.5), 0.0, None),
        (commands(0.5), 0.2, None),
        ([], 0.0, None),
    ],
)
def test_robot_stands_from_first_of_the_final_zeros(
    given: Sequence[Commanded], since: float, expected: float | None
) -> None:
    assert judge.stood(given, since, 1.0) == pytest.approx(expected)


def test_went_on_requires_commands_without_stop_or_gap() -> None:
    assert judge.went_on(commands(*[0.5] * 30), 0.0, 1.4)
    assert not judge.went_on(commands(*[0.5] * 10, 0.0, *[0.5] * 19), 0.0, 1.4)
    assert not judge.went_on(commands(*[0.5] * 10), 0.0, 1.4), "commands end early"
    assert not judge.went_on([*commands(0.5, 0.5), *commands(0.5, 0.5, since=0.9)], 0.0, 0.95), "a gap"
    assert not judge.went_on([], 0.0, 1.0)


def test_successive_leaders_are_no_rivals() -> None:
    leads = [led(0.0), led(1.0), led(1.5, "b", 2), led(2.0, "b", 2)]
    assert judge.rivals(leads) == []
    assert [one.publisher_id for one in judge.leader_terms(leads)] == ["a", "b"]
    assert judge.rivals([led(0.0), led(1.0), led(2.0, "a2", 3)]) == []


def test_alternating_or_returning_publishers_are_rivals() -> None:
    ((one, other),) = judge.rivals([led(0.0), led(1.0, "b", 2), led(1.1), led(2.0, "b", 2)])
    assert (one.publisher_id, other.publisher_id) == ("a", "b")
    assert judge.rivals([led(0.0), led(1.0, "b", 2), led(3.0)])


def test_takeover_ends_with_first_message_of_new_leader() -> None:
    leads = [led(0.0), led(1.0), led(1.1), led(1.8, "b", 2)]
    assert judge.taken_over(leads, 1.05) == pytest.approx(0.75)
    assert judge.taken_over(leads[:-1], 1.05) is None


def driven(astray: complex = 0j, leader_until: float = 2.0) -> Seen:
    """Two seconds at 0.2 m/s with every robot in its slot, but robot4 `astray` from it."""
    seen, slots = Seen(SIX), SIX.slots()
    for n in range(41):
        at = 0.05 * n
        if at <= leader_until:
            order = {"term": 1, "beat": n, "mode": "run", "shape": "hexagon"}
            seen.process_line(["lead", at, 0.2 * at, 0.0, {"publisher_id": "a", "count": n, "order": order}])
        for name, slot in zip(SIX.followers, slots[1:], strict=True):
            point = slot + 0.2 * at + (astray if name == "robot4" else 0j)
            centre = point - SIX.robots[name].control_point_offset * cmath.rect(1.0, 0.3)
            seen.process_line(["truth", at + 0.01, name, centre.real, centre.imag, 0.3])
    return seen


def test_team_in_its_slots_has_no_error() -> None:
    seen = driven()
    inner = judge.grid(0.1, 1.9)
    assert seen.errors(inner).max() == pytest.approx(0.0, abs=0.02)  # 0.01 s at 0.2 m/s on each edge's ends
    assert seen.now == pytest.approx(2.01)


def test_error_sums_edges_of_displaced_robot() -> None:
    edges = sum("robot4" in (name, other) for name in SIX.names for other in SIX.robots[name].neighbours)
    away = driven(0.3j).errors(np.array([1.0])) - driven().errors(np.array([1.0]))
    assert away == pytest.approx(0.3 * edges, rel=0.05)


def test_robots_without_running_neighbour_are_holders() -> None:
    assert holders(SIX, ["robot3"]) == set()  # robot4 has robot2, robot5 has robot4
    assert holders(SIX, ["robot4", "robot3"]) == {"robot5", "robot6"}
