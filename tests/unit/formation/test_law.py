from __future__ import annotations

import cmath

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.control.controller import (
    Controller,
    Gains,
    Limits,
    Measured,
    Step,
    error,
    near,
    nominal,
    unwound,
)
from formation.control.laws import LAWS
from formation.control.laws.field import field
from formation.control.laws.paper import paper
from formation.control.laws.proportional import proportional
from formation.control.unicycle import Command, body_velocity
from tests.unit.formation import oracle
from tests.unit.formation.planar import angles, gains, headings, lengths, pair, vectors

EDGES = st.lists(st.tuples(vectors, vectors), min_size=1, max_size=5)
"""z_ij^(i) and z*_ij of each neighbour."""
limits = st.builds(Limits, lengths, lengths, lengths)
parameters = st.tuples(gains, gains).map(lambda drawn: Gains(*drawn))
STEPS = {name: one.step for name, one in LAWS.items()}
all_laws = pytest.mark.parametrize("law", STEPS.values(), ids=STEPS)


def sums(edges: list[tuple[complex, complex]], velocity: complex = 0j) -> Measured:
    return Measured(sum(z for z, _ in edges), sum(wanted for _, wanted in edges), len(edges), velocity)


@given(EDGES, vectors, vectors, parameters, limits, st.floats(0.001, 0.1))
def test_the_paper_law_is_the_paper_to_the_letter(
    edges: list[tuple[complex, complex]],
    integral: complex,
    estimate: complex,
    law: Gains,
    body: Limits,
    dt: float,
) -> None:
    measured, desired = ([pair(edge[k]) for edge in edges] for k in (0, 1))
    reference = oracle.nominal(measured, desired, pair(integral), pair(estimate), law.k_p, law.k_i)
    expected = oracle.saturated(reference, body.offset, body.max_speed, body.max_turn_rate)
    grown = pair(integral) + dt * oracle.integrand(measured, desired, pair(estimate))
    command, after = paper(integral, estimate, sums(edges), law, body, dt)
    assert command == pytest.approx(expected, rel=1e-9, abs=1e-9)
    assert pair(after) == pytest.approx(grown, rel=1e-9, abs=1e-9)


@given(EDGES, vectors, headings, parameters, limits)
def test_commands_are_within_their_limits(
    edges: list[tuple[complex, complex]], integral: complex, heading: complex, law: Gains, body: Limits
) -> None:
    for each in STEPS.values():
        command, _ = each(integral, heading, sums(edges, 3.0 + 1.0j), law, body, 0.05)
        assert abs(command.speed) <= body.max_speed
        assert abs(command.turn_rate) <= body.max_turn_rate


@all_laws
@given(EDGES, vectors, headings, vectors, angles, parameters, limits)
def test_turning_the_world_turns_nothing_on_the_robot(
    law: Step,
    edges: list[tuple[complex, complex]],
    integral: complex,
    heading: complex,
    velocity: complex,
    angle: float,
    parameters: Gains,
    body: Limits,
) -> None:
    turn = cmath.rect(1.0, angle)
    turned = [(z, turn * wanted) for z, wanted in edges]
    command, after = law(integral, heading, sums(edges, velocity), parameters, body, 0.05)
    same, same_after = law(
        turn * integral, turn * heading, sums(turned, turn * velocity), parameters, body, 0.05
    )
    assert same == pytest.approx(command, abs=1e-9)
    assert same_after == pytest.approx(turn * after, abs=1e-9)


@pytest.mark.parametrize("law", [field, paper])
@given(headings, vectors, parameters)
def test_integral_in_formation_is_constant_and_gives_velocity(
    law: Step, heading: complex, desired: complex, parameters: Gains
) -> None:
    velocity = 0.2 + 0.1j
    body = Limits(0.1, 5.0, 50.0)
    integral = velocity / parameters.k_i
    at_rest = Measured(heading.conjugate() * desired, desired, 2)
    command, after = law(integral, heading, at_rest, parameters, body, 0.05)
    assert after == pytest.approx(integral, abs=1e-9)
    assert heading * body_velocity(*command, body.offset) == pytest.approx(velocity, abs=1e-9)


@given(headings, vectors)
def test_field_law_with_known_velocities_needs_no_integral(heading: complex, desired: complex) -> None:
    body = Limits(0.1, 5.0, 50.0)
    moving = Measured(heading.conjugate() * desired, desired, 1, 0.3 - 0.2j)
    command, integral = field(0j, heading, moving, Gains(2.0, 1.0), body, 0.05)
    assert heading * body_velocity(*command, body.offset) == pytest.approx(0.3 - 0.2j)
    assert integral == pytest.approx(0j, abs=1e-12)


@given(vectors.filter(lambda e: abs(e) > 1.0), vectors)
def test_far_from_formation_the_field_law_forgets_its_integral(away: complex, integral: complex) -> None:
    law = Gains(2.0, 1.0, anti_windup=0.0, integral_band=0.03, integral_decay=1.0)
    for _ in range(100):
        _, integral = field(integral, 1.0 + 0j, Measured(away, 0j, 1), law, Limits(0.1, 1.0, 1.0), 0.1)
    assert abs(integral) < 1e-2


@pytest.mark.parametrize(("decay", "dt"), [(1.0, 3.0), (100.0, 0.05), (1e6, 0.05)])
def test_forgetting_never_overshoots_however_long_the_interval(decay: float, dt: float) -> None:
    law = Gains(2.0, 1.0, anti_windup=0.0, integral_decay=decay)
    integral = 1.0 + 0j
    for _ in range(10):
        before = abs(integral)
        _, integral = field(integral, 1.0 + 0j, Measured(3.0 + 0j, 0j, 1), law, Limits(0.1, 1.0, 1.0), dt)
        assert abs(integral) <= before + 1e-6
    assert abs(integral) < 1e-3


def test_the_paper_law_winds_up_where_the_field_law_does_not() -> None:
    wound, unwound = 0j, 0j
    body = Limits(0.1, 0.2, 1.0)
    for _ in range(100):
        _, wound = paper(wound, 1.0 + 0j, Measured(3.0 + 0j, 0j, 1), Gains(2.0, 1.0), body, 0.1)
        _, unwound = field(unwound, 1.0 + 0j, Measured(3.0 + 0j, 0j, 1), Gains(2.0, 1.0), body, 0.1)
    assert wound == pytest.approx(30.0)
    assert abs(unwound) < 1e-3


def test_near_formation_what_saturation_cuts_off_comes_out_of_the_integral() -> None:
    body, law = Limits(0.1, 0.1, 1.0), Gains(2.0, 1.0, anti_windup=1.0, integral_band=1e3)
    integral = 1.0 + 0j
    for _ in range(200):
        _, integral = field(integral, 1.0 + 0j, Measured(0j, 0j, 1), law, body, 0.05)
    assert integral.real == pytest.approx(0.1, abs=1e-3)


@given(st.floats(-0.1, 0.1), st.floats(-1.0, 1.0), headings)
def test_command_reduced_after_law_unwinds_like_saturation(
    speed: float, turn_rate: float, heading: complex
) -> None:
    law, wide, wanted = Gains(2.0, 1.0), Limits(0.1, 5.0, 50.0), Measured(0.01 + 0.02j, 0j, 1, 0.3 + 0j)
    result, after = field(0.1 + 0j, heading, wanted, law, wide, 0.05)
    assert unwound(after, heading, wanted, law, wide, result, result, 0.05) == after
    done = Command(speed, turn_rate)
    held = body_velocity(*done, 0.1) - body_velocity(*result, 0.1)
    growth = unwound(after, heading, wanted, law, wide, result, done, 0.05) - after
    near_enough = near(abs(error(heading, wanted)), law.integral_band)
    assert growth == pytest.approx(0.05 * near_enough * heading * held, abs=1e-12)


@given(st.floats(0.001, 1.0))
def test_the_band_is_flat_at_zero_and_half_at_its_edge(band: float) -> None:
    assert near(0.0, band) == 1.0
    assert near(band, band) == pytest.approx(0.5)
    assert near(0.1 * band, band) > 0.9998
    assert near(10.0 * band, band) < 2e-4


@given(EDGES, headings, parameters)
def test_the_error_is_what_the_nominal_law_brings_to_zero(
    edges: list[tuple[complex, complex]], heading: complex, law: Gains
) -> None:
    measured = sums(edges)
    assert heading * nominal(0j, heading, measured, law) == pytest.approx(
        law.k_p * error(heading, measured), abs=1e-9
    )


@given(EDGES, headings, vectors, parameters)
def test_proportional_law_follows_its_neighbours_velocity(
    edges: list[tuple[complex, complex]], heading: complex, velocity: complex, law: Gains
) -> None:
    measured, wide = sums(edges, velocity), Limits(0.1, 1e9, 1e9)
    command, integral = proportional(0j, heading, measured, law, wide, 0.05)
    wanted = law.k_p * error(heading, measured) + velocity
    assert heading * body_velocity(*command, wide.offset) == pytest.approx(wanted, abs=1e-6)
    assert integral == 0j


@pytest.mark.parametrize("controller", LAWS.values(), ids=LAWS)
@given(EDGES, headings, vectors, parameters, limits)
def test_declared_needs_of_a_law_are_its_own(
    controller: Controller,
    edges: list[tuple[complex, complex]],
    heading: complex,
    velocity: complex,
    law: Gains,
    body: Limits,
) -> None:
    """What a `Controller` says that it does not use has no effect."""
    step, still = controller.step, sums(edges)
    if not controller.integral:
        reported, kept = step(1.0 + 2.0j, heading, still, law, body, 0.05)
        assert reported == step(0j, heading, still, law._replace(k_i=0.0), body, 0.05)[0]
        assert kept == 1.0 + 2.0j
    if not controller.feed_forward:
        reported, _ = step(0j, heading, sums(edges, velocity), law, body, 0.05)
        assert reported == step(0j, heading, still, law, body, 0.05)[0]


def test_laws_are_offered_by_name() -> None:
    assert list(LAWS) == ["field", "paper", "proportional"]
    assert all(LAWS[name].name == name for name in LAWS)
