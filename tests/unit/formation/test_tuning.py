"""Which gains may be ordered: exactly those that the graph bears, and else the sentence that says why not."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from formation.agent.following.gains import Bearable
from formation.mission.file import load
from formation.mission.model import Mission
from formation.protocol.order import OperatorRequest, Tuned
from formation.stability import intent, spectrum, tuning
from formation.transport.asking import request_for
from tests.support.gains import MARGIN, drawn, held, stable, unstable
from tests.unit.formation import scenarios

SIX = load("six_robots")


def test_a_hundred_unstable_gains_of_a_hundred_are_refused() -> None:
    refused = 0
    for mission, gains in unstable(100):
        why = tuning.refusal(mission, gains)
        refused += why is not None and "eigenvalue" in why and f"at k_p = {gains.k_p:g}" in why
    assert refused == 100


@pytest.mark.slow
def test_a_hundred_stable_gains_of_a_hundred_are_accepted() -> None:
    drawn_ones = list(stable(100))
    assert sum(tuning.refusal(mission, gains) is None for mission, gains, _ in drawn_ones) == 100
    assert sum(near for _, _, near in drawn_ones) > 20


@pytest.mark.slow
@pytest.mark.parametrize("side", [1.0 - MARGIN, 1.0 + MARGIN])
def test_gains_are_refused_exactly_where_the_sampled_loop_no_longer_settles(side: float) -> None:
    random, judged = np.random.default_rng(9), 0
    while judged < 100:
        mission = drawn(random, float(random.uniform(2.0, 50.0)), kind="paper")
        period = 1.0 / mission.robots[mission.followers[0]].rate
        k_i = float(10.0 ** random.uniform(-2.0, 0.5))
        fits = [
            k_p
            for k_p in np.geomspace(0.01, 100.0, 300).tolist()
            if held(mission, Tuned(k_p=k_p, k_i=k_i), period) < 1.0
        ]
        if not fits:
            continue
        low, high = fits[-1], fits[-1] * 1.1
        for _ in range(40):
            middle = 0.5 * (low + high)
            settles = held(mission, Tuned(k_p=middle, k_i=k_i), period) < 1.0
            low, high = (middle, high) if settles else (low, middle)
        why = tuning.refusal(mission, Tuned(k_p=low * side, k_i=k_i))
        assert (why is None) == (side < 1.0)
        judged += 1


@pytest.mark.parametrize(
    ("mission", "typed", "why"),
    [
        (
            scenarios.ring(12, k_i=0.1, kind="paper"),
            {"k_i": 30.0},
            r"k_i = 30: unstable, eigenvalue 0\.\d+\+0\.\d+i needs k_i < \d+\.?\d* at k_p = 2",
        ),
        (
            scenarios.ring(12, k_i=0.1, kind="paper"),
            {"k_p": 0.01},
            r"k_p = 0\.01: unstable, eigenvalue \S+ needs k_p > [\d.]+ at k_i = 0\.1",
        ),
        (
            SIX,
            {"k_p": 60.0},
            r"k_p = 60: overshoots at robot2's 20 Hz, eigenvalue 2 needs k_p < 20 at k_i = .*",
        ),
        (
            SIX,
            {"k_i": 50.0},
            r"k_i = 50: overshoots at robot2's 20 Hz, eigenvalue \d needs k_i < [\d.]+ at k_p = 2",
        ),
        (SIX, {"k_p": 1e-3}, r"k_p = 0.001: overshoots .* needs k_p > .*"),
        (SIX, {"k_p": 900.0, "k_i": 900.0}, r".*no k_p or k_i will do without the other|.*needs .*"),
    ],
)
def test_a_refusal_names_the_gain_the_eigenvalue_and_the_legal_range(
    mission: Mission, typed: dict[str, float], why: str
) -> None:
    law = mission.law
    request = OperatorRequest.model_validate({"do": "tune", **typed})
    wanted = intent.tuned(request, Tuned(k_p=law.k_p, k_i=law.k_i))
    result = intent.refusal(mission, request, gains=wanted)
    assert result is not None
    assert re.fullmatch(why, result), result
    assert len(result) <= 120
    bound = re.search(r"needs (k_.) ([<>]) ([\d.e+-]+) at", result)
    if bound is not None:
        name, beyond, value = bound[1], bound[2], float(bound[3])
        inside = value * (0.999 if beyond == "<" else 1.001)
        assert tuning.refusal(mission, wanted.model_copy(update={name: inside})) is None
        outside = value * (1.02 if beyond == "<" else 0.98)
        assert tuning.refusal(mission, wanted.model_copy(update={name: outside})) is not None


def test_velocities_fed_forward_round_a_cycle_are_looked_at_as_well() -> None:
    mission = scenarios.ring(6, k_p=2.0, k_i=0.05, velocity_filter=0.5)
    faults = [
        (gains, why)
        for k_i in (0.05, 0.2, 0.5, 1.0, 2.0)
        for gains in [Tuned(k_p=2.0, k_i=k_i)]
        for why in [tuning.refusal(mission, gains)]
        if spectrum.stable(spectrum.laplacian(mission.graph), 2.0, k_i)
    ]
    assert any(why is None for _, why in faults)
    for gains, why in faults:
        poles = spectrum.feed_forward_poles(mission.graph, gains.k_p, gains.k_i, 0.5)
        assert (why is None) == (poles.real.max() < 0.0)


def test_refusal_of_large_cycle_names_pole_without_range() -> None:
    size = 40
    around = np.concatenate([[0.0], 10.0 * np.exp(2j * np.pi * np.arange(size) / size)])
    neighbours = ((), (0, size), *((i,) for i in range(1, size)))
    mission = scenarios.build(around, neighbours, law={"k_i": 0.001, "velocity_filter": 0.5})
    assert spectrum.stable(spectrum.laplacian(mission.graph), 2.0, 0.001)
    why = tuning.refusal(mission, Tuned(k_p=2.0, k_i=0.001))
    assert why is not None
    assert re.fullmatch(
        r"k_p = 2, k_i = 0\.001: unstable with law.feed_forward, pole \S+ 1/s; other gains are needed", why
    )


def test_the_loop_without_an_integral_is_judged_by_its_positions_alone() -> None:
    assert tuning.refusal(SIX, Tuned(k_p=2.0, k_i=0.0)) is None
    assert tuning.refusal(scenarios.ring(6), Tuned(k_p=2.0, k_i=0.0)) is None
    assert tuning.refusal(SIX, Tuned(k_p=30.0, k_i=0.0)) is not None


def test_single_gain_is_left_to_the_leader_to_judge() -> None:
    assert request_for(SIX, "tune", k_i=50.0).k_i == 50.0  # its leader may have k_p = 10 by now
    with pytest.raises(ValueError, match="k_i = 50: overshoots"):
        request_for(SIX, "tune", k_i=50.0, k_p=2.0)


@pytest.mark.parametrize("wrong", [0.0, -1.0, 1e-4, 1001.0, math.inf, math.nan])
def test_a_gain_that_is_none_is_no_request(wrong: float) -> None:
    with pytest.raises(ValueError, match=r"tune: k_p = .*: must be"):
        request_for(SIX, "tune", k_p=wrong)


@pytest.mark.slow
@settings(max_examples=300)
@given(
    seed=st.integers(0, 2**32),
    rate=st.floats(1.0, 100.0),
    k_p=st.floats(-3.0, 3.0),
    k_i=st.floats(-3.0, 3.0),
)
def test_what_a_leader_may_order_every_robot_can_bear(seed: int, rate: float, k_p: float, k_i: float) -> None:
    mission = drawn(np.random.default_rng(seed), rate)
    gains = Tuned(k_p=10.0**k_p, k_i=10.0**k_i)
    assume(tuning.refusal(mission, gains) is None)
    Bearable.of(mission).check(gains)


@given(
    seed=st.integers(0, 2**32),
    ends=st.tuples(*[st.floats(-2.0, 2.0)] * 4),
    part=st.floats(0.0, 1.0),
)
def test_straight_between_stable_gains_all_are_stable(
    seed: int, ends: tuple[float, float, float, float], part: float
) -> None:
    mu = spectrum.laplacian(drawn(np.random.default_rng(seed)).graph)
    one, other = np.array(ends[:2]), np.array(ends[2:])
    for gains in (one, other):
        assume(spectrum.stable(mu, *np.exp(gains).tolist()))
    between = np.exp(one + part * (other - one))
    assert spectrum.stable(mu, float(between[0]), float(between[1]) * (1.0 - 1e-9))
