from __future__ import annotations

import math
from pathlib import Path
from zlib import crc32

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from formation.control import laws
from formation.control.controller import Controller, Gains, Limits, Measured, Step, nominal
from formation.control.laws import LAWS
from formation.control.laws.field import CONE_SHARE, field, intercepting, stoppable, stoppable_turn, turning
from formation.control.laws.paper import paper
from formation.control.laws.proportional import proportional
from formation.control.trust import GREATEST_WEIGHT, Trust, mean, trust, weighted
from formation.control.unicycle import Command, body_velocity
from formation.stability.certificate import least_reverse
from tests.unit.formation import oracle
from tests.unit.formation.planar import gains, headings, lengths, pair, vectors

Edges = list[tuple[complex, complex]]
"""z_ij^(i) and z*_ij of each neighbour."""
EDGES = st.lists(st.tuples(vectors, vectors), min_size=1, max_size=5)
limits = st.builds(Limits, lengths, lengths, lengths, st.floats(0.1, 100.0), st.booleans())
parameters = st.builds(Gains, gains, gains)
WIDE = Limits(0.1, 1e9, 1e9)
STEPS = {name: one.step for name, one in LAWS.items()}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "ImportError: must define CONTROLLER"),
        ("CONTROLLER = print", "ImportError: must define CONTROLLER"),
        (
            "from formation.control.laws.field import CONTROLLER",
            "ImportError: the name of its CONTROLLER is 'field', must be",
        ),
        ("def step(:", "SyntaxError: invalid syntax"),
        ("import nothing_of_that_name", "ModuleNotFoundError: No module named 'nothing_of_that_name'"),
        ("raise ValueError('one\\ntwo')", "ValueError: one"),
        ("raise SystemExit(3)", "SystemExit: 3"),
    ],
    ids=["none", "function", "name of another", "no Python", "missing module", "two lines", "exit"],
)
def test_file_without_law_of_its_own_is_left_out(
    content: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = f"wrong_law_{crc32(content.encode())}"
    (tmp_path / f"{name}.py").write_text(content, encoding="utf-8")
    monkeypatch.setattr(laws, "__path__", [*laws.__path__, str(tmp_path)])
    usable, unusable = laws.load([name, "paper"])
    assert list(usable) == ["paper"]
    assert unusable[name].startswith(f"{name}.py cannot be used: {message}")
    assert "\n" not in unusable[name]


def test_unusable_law_raises_when_it_should_drive(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(laws, "UNUSABLE", {"mine": "mine.py cannot be used: no step"})
    with pytest.raises(ImportError, match="cannot be used: no step"):
        laws.law_of("mine").step(0j, 1.0 + 0j, sums([]), Gains(1.0, 0.0), WIDE, 0.05)
    assert laws.law_of("field") is LAWS["field"]


def sums(edges: Edges, velocity: complex = 0j) -> Measured:
    return Measured(sum(z for z, _ in edges), sum(wanted for _, wanted in edges), len(edges), velocity)


@given(EDGES, vectors, vectors, parameters, limits, st.floats(0.001, 0.1))
def test_paper_law_matches_equations_of_the_paper(
    edges: Edges, integral: complex, estimate: complex, law: Gains, body: Limits, dt: float
) -> None:
    measured, desired = ([pair(edge[k]) for edge in edges] for k in (0, 1))
    reference = oracle.nominal(measured, desired, pair(integral), pair(estimate), law.k_p, law.k_i)
    expected = oracle.saturated(reference, body.offset, body.max_speed, body.max_turn_rate)
    grown = pair(integral) + dt * oracle.integrand(measured, desired, pair(estimate))
    command, after = paper(integral, estimate, sums(edges), law, body, dt)
    assert command == pytest.approx(expected, rel=1e-9, abs=1e-9)
    assert pair(after) == pytest.approx(grown, rel=1e-9, abs=1e-9)


@given(EDGES, vectors, headings, parameters, limits)
def test_commands_are_within_limits(
    edges: Edges, integral: complex, heading: complex, law: Gains, body: Limits
) -> None:
    for each in STEPS.values():
        command, _ = each(integral, heading, sums(edges, 3.0 + 1.0j), law, body, 0.05)
        assert abs(command.speed) <= body.max_speed
        assert abs(command.turn_rate) <= body.max_turn_rate


@pytest.mark.parametrize("law", STEPS.values(), ids=STEPS)
@given(EDGES, vectors, headings, vectors, headings, parameters, limits)
def test_command_is_invariant_to_rotation_of_the_world(
    law: Step,
    edges: Edges,
    integral: complex,
    heading: complex,
    velocity: complex,
    turn: complex,
    gain: Gains,
    body: Limits,
) -> None:
    command, after = law(integral, heading, sums(edges, velocity), gain, body, 0.05)
    turned = sums([(z, turn * wanted) for z, wanted in edges], turn * velocity)
    same, same_after = law(turn * integral, turn * heading, turned, gain, body, 0.05)
    assert same == pytest.approx(command, abs=1e-9)
    assert same_after == pytest.approx(turn * after, abs=1e-9)


@given(headings, vectors)
def test_field_law_with_known_velocities_needs_no_integral(heading: complex, desired: complex) -> None:
    moving = Measured(heading.conjugate() * desired, desired, 1, 0.3 - 0.2j)
    command, integral = field(0j, heading, moving, Gains(2.0, 1.0), WIDE, 0.05)
    assert heading * body_velocity(*command, WIDE.offset) == pytest.approx(0.3 - 0.2j)
    assert integral == pytest.approx(0j, abs=1e-12)


velocities = st.builds(complex, st.floats(-0.4, 0.4), st.floats(-0.4, 0.4))
BODIES = st.builds(
    Limits, st.floats(0.05, 0.3), st.floats(0.8, 2.0), st.floats(0.5, 3.0), st.floats(1.0, 100.0)
)


def approach(away: complex, velocity: complex, heading: complex, gain: float, body: Limits) -> float:
    """Speed at which the law closes in on a slot `away` that moves at `velocity` [m/s]."""
    measured = Measured(heading.conjugate() * away, 0j, 1, velocity)
    command, _ = field(0j, heading, measured, Gains(gain, 0.0), body, 0.05)
    moving = heading * body_velocity(*command, body.offset)
    return ((moving - velocity) * away.conjugate()).real / abs(away)


def slower(velocity: complex, body: Limits) -> complex:
    """`velocity`, or less, so that a robot can move as fast to the side."""
    most = 0.8 * min(body.max_speed, body.offset * body.max_turn_rate)
    return velocity * min(1.0, most / abs(velocity)) if velocity else velocity


@given(vectors.filter(lambda e: abs(e) > 1e-3), velocities, headings, st.floats(0.5, 12.0), BODIES)
def test_slot_slower_than_sideways_speed_comes_nearer(
    away: complex, velocity: complex, heading: complex, gain: float, body: Limits
) -> None:
    """Lemma 1 of docs/theory/convergence.md, for every heading; with the ramp's limits at least nearer."""
    velocity = slower(velocity, body)
    assert approach(away, velocity, heading, gain, body._replace(reverses=False)) > 0.0
    spare = min(body.max_speed, body.offset * body.max_turn_rate) - abs(velocity)
    ideal = body._replace(acceleration=math.inf, reverses=False)
    least = 0.5 * min(gain * abs(away), spare)
    assert approach(away, velocity, heading, gain, ideal) >= least * (1.0 - 1e-9)


@given(vectors, velocities, st.floats(1.0, 12.0), BODIES)
@example(-0.1000001 - 0.2137j, 0j, 5.0, Limits(0.04, 1.5, 7.5))
def test_slot_far_behind_comes_nearer_in_reverse(
    away: complex, velocity: complex, gain: float, body: Limits
) -> None:
    """The reverse rule of that page: the gain is high enough to want what is left of the top speed."""
    body = body._replace(acceleration=math.inf)
    velocity, behind = slower(velocity, body), least_reverse(body)
    gain = max(gain, body.max_speed / behind)
    away = complex(-behind - abs(away.real), away.imag)
    assert approach(away, velocity, 1.0 + 0j, gain, body) > 0.0


def test_slot_far_behind_may_recede_in_reverse_at_low_gain() -> None:
    body, away, velocity = Limits(0.13, 1.16, 2.0), -0.34 + 0.39j, 0.05 + 0.2j
    assert least_reverse(body) * 0.73 < body.max_speed
    assert approach(away, velocity, 1.0 + 0j, 0.73, body) < -0.1
    assert approach(away, velocity, 1.0 + 0j, body.max_speed / least_reverse(body), body) > 0.0


@given(vectors.filter(lambda e: abs(e) > 1e-3), velocities, st.floats(0.5, 12.0), BODIES)
def test_intercepting_velocity_is_within_max_speed(
    away: complex, velocity: complex, gain: float, body: Limits
) -> None:
    towards, closing = away / abs(away), stoppable(abs(away), gain, away / abs(away), body)
    closing = intercepting(towards, velocity, closing, body)
    assert closing >= 0.0
    assert abs(velocity + closing * towards) <= body.max_speed + 1e-9


@given(vectors.filter(lambda e: abs(e) > 1e-3), headings, st.floats(1.01, 10.0), BODIES)
def test_turning_velocity_is_in_cone(away: complex, direction: complex, excess: float, body: Limits) -> None:
    towards, sideways = away / abs(away), CONE_SHARE * body.offset * body.max_turn_rate
    velocity = excess * sideways * direction
    wanted = velocity + turning(towards, velocity, 1e3, body) * towards
    across = abs((wanted * velocity.conjugate()).imag) / abs(velocity)
    assert across <= sideways / abs(velocity) * abs(wanted) + 1e-9
    assert (wanted * velocity.conjugate()).real > 0.0


@given(st.floats(1e-3, 30.0), headings, st.floats(0.5, 12.0), st.floats(0.5, 20.0))
def test_approach_can_be_stopped_by_the_ramp(
    distance: float, towards: complex, gain: float, acceleration: float
) -> None:
    body, step = Limits(0.1, 1.5, 1.0, acceleration), 1e-3
    while distance > 1e-3:
        speed = stoppable(distance, gain, towards, body)
        slowed = speed - stoppable(distance - step * speed, gain, towards, body)
        assert slowed * abs(towards.real) <= step * acceleration * (1.0 + 1e-6)
        assert slowed * abs(towards.imag) <= step * acceleration * 0.1 / 1.5 * (1.0 + 1e-6)
        distance -= step * speed


@given(st.floats(1e-3, math.pi), st.floats(0.5, 20.0))
def test_turn_can_be_stopped_by_the_ramp(angle: float, acceleration: float) -> None:
    body, step = Limits(0.1, 1.5, 1.0, acceleration), 1e-3
    while angle > 1e-2:
        rate = stoppable_turn(angle, body)
        assert rate - stoppable_turn(angle - step * rate, body) <= step * acceleration / 1.5 * (1.0 + 1e-6)
        angle -= step * rate


def facing_x(away: complex, velocity: complex, gain: float, body: Limits) -> Command:
    """The field law's command for a robot that faces along x."""
    return field(0j, 1.0 + 0j, Measured(away, 0j, 1, velocity), Gains(gain, 0.0), body, 0.05)[0]


def test_turn_rate_is_limited_to_stoppable_turn() -> None:
    slow = Limits(0.05, 1.0, 2.0, 1.0)
    turn_rate = facing_x(0j, 1.0 + 0.1j, 2.0, slow).turn_rate
    assert turn_rate == stoppable_turn(math.atan2(0.1, 1.0), slow) < 2.0
    assert facing_x(0j, 1.0 + 0.1j, 2.0, slow._replace(acceleration=math.inf)).turn_rate == 2.0


def test_robot_reverses_only_to_slot_far_behind() -> None:
    body = Limits(0.2, 1.5, 1.5)
    reversing = facing_x(-3.0 - 0.5j, 0j, 8.0, body)
    assert reversing.speed < 0.0 < reversing.turn_rate
    assert facing_x(-0.4 - 0.1j, 0j, 8.0, body).turn_rate < 0.0
    assert facing_x(-3.0 - 0.5j, 0j, 8.0, body._replace(reverses=False)).turn_rate < 0.0


@given(st.floats(0.0, 2.0), st.floats(0.1, 1.0), st.floats(0.3, 2.0))
def test_weight_falls_with_speed_above_leader_speed(speed: float, leader: float, top: float) -> None:
    least = trust(speed + 0j, leader, top)
    assert 0.0 < least.weight <= trust(0.9 * speed * 1j, leader, top).weight <= GREATEST_WEIGHT
    if speed <= leader:
        assert least == Trust(GREATEST_WEIGHT, 0j)


@given(headings, st.floats(0.0, 2.0), st.floats(0.1, 1.0), st.floats(0.3, 2.0))
def test_fast_neighbour_counts_more_across_its_motion(
    direction: complex, excess: float, leader: float, top: float
) -> None:
    one = trust((leader + excess) * direction, leader, top)
    along, across = (weighted(one.weight, one.skew, vector) for vector in (direction, 1j * direction))
    assert along == pytest.approx(abs(along) * direction)
    assert across == pytest.approx(abs(across) * 1j * direction)
    assert 0.0 < abs(along) <= abs(across) * (1.0 + 1e-9)


@given(st.lists(st.tuples(velocities, vectors), min_size=1, max_size=5))
def test_weighted_mean_matches_matrices(neighbours: list[tuple[complex, complex]]) -> None:
    trusts, points = (
        [trust(5.0 * velocity, 0.2, 1.5) for velocity, _ in neighbours],
        [h for _, h in neighbours],
    )
    weight, skew = sum(one.weight for one in trusts), sum(one.skew for one in trusts)
    total = sum(weighted(one.weight, one.skew, h) for one, h in zip(trusts, points, strict=True))
    assert mean(weight, skew, total) == pytest.approx(oracle.weighted_mean(trusts, points), abs=1e-6)
    same = sum(weighted(one.weight, one.skew, points[0]) for one in trusts)
    assert mean(weight, skew, same) == pytest.approx(points[0], abs=1e-9)


def test_two_fast_neighbours_show_where_their_slots_are() -> None:
    """Their paths cross where they are heading: the mean is near there, not between them."""
    trusts = [trust(1.5 + 0j, 0.2, 1.5), trust(1.5j, 0.2, 1.5)]
    points = [-2.0 + 0j, -2.0j]
    total = sum(weighted(one.weight, one.skew, h) for one, h in zip(trusts, points, strict=True))
    assert abs(mean(sum(one.weight for one in trusts), sum(one.skew for one in trusts), total)) < 0.3


@given(EDGES, headings, vectors, parameters)
def test_proportional_law_adds_neighbour_velocity_to_nominal_law(
    edges: Edges, heading: complex, velocity: complex, law: Gains
) -> None:
    measured = sums(edges, velocity)
    command, integral = proportional(0j, heading, measured, law, WIDE, 0.05)
    wanted = heading * nominal(0j, heading, measured, law) + velocity
    assert heading * body_velocity(*command, WIDE.offset) == pytest.approx(wanted, abs=1e-6)
    assert integral == 0j


@pytest.mark.parametrize("controller", LAWS.values(), ids=LAWS)
@given(EDGES, headings, vectors, parameters, limits)
def test_law_ignores_inputs_declared_unused(
    controller: Controller, edges: Edges, heading: complex, velocity: complex, law: Gains, body: Limits
) -> None:
    """Inputs that its `Controller` declares unused have no effect."""
    step, still = controller.step, sums(edges)
    if not controller.integral:
        reported, kept = step(1.0 + 2.0j, heading, still, law, body, 0.05)
        assert reported == step(0j, heading, still, law._replace(k_i=0.0), body, 0.05)[0]
        assert kept == 1.0 + 2.0j
    if not controller.feed_forward:
        reported, _ = step(0j, heading, sums(edges, velocity), law, body, 0.05)
        assert reported == step(0j, heading, still, law, body, 0.05)[0]
