"""Gains that change while robots drive: no command jumps, equal gains in the end, exact verification."""

from __future__ import annotations

import cmath
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.agent.following.gains import INTEGRAL_RATE_RATIO, MAX_GAIN_RATE, Tuning
from formation.agent.following.gains import MAX_COMMAND_STEP_SHARE as MOST
from formation.agent.following.orders import Orders
from formation.control.controller import Measured
from formation.control.laws import LAWS
from formation.mission.file import load
from formation.mission.model import Mission
from formation.protocol.json_message import decode
from formation.protocol.order import Order, Tuned
from formation.wire import BadMessage, Now
from tests.campaigns.safety.gains import changed, limited, tune
from tests.support.examples import slow
from tests.support.fleet import EPOCH, Fleet
from tests.support.recorded import RecordedFleet, all_alike, verify
from tests.support.restarting import driving

SIX, PAIR, PATROL = load("six_robots"), load("turtlebot3_pair"), load("patrol")
MISSIONS = {"six": SIX, "pair": PAIR, "patrol": PATROL}
GAINS = st.builds(Tuned, k_p=st.floats(0.05, 50.0), k_i=st.one_of(st.just(0.0), st.floats(0.01, 50.0)))
PLANE = st.complex_numbers(max_magnitude=5.0)
AT_PLACE = Measured(0j, 0j, 1)
JUMP = 0.1
"""Greatest change of a command that new gains may cause [share of a limit]."""


def ordered(tuned: Tuned | None) -> Order:
    return Order(term=1, beat=1, mode="run", shape="hexagon", tuned=tuned)


def in_force(fleet: Fleet) -> set[tuple[float, float]]:
    return {(agent.tuning.state.k_p, agent.tuning.state.k_i) for agent in fleet.agents.values()}


def tuning_with(k_p: float, k_i: float, law: str = "field") -> Tuning:
    one = Tuning(SIX, "robot2", LAWS[law])
    one.state.k_p, one.state.k_i = k_p, k_i
    return one


@given(since=GAINS, to=GAINS, dts=st.lists(st.floats(0.0, 0.3), max_size=60), integral=PLANE)
def test_integral_part_of_command_stays_while_gains_change(
    since: Tuned, to: Tuned, dts: list[float], integral: complex
) -> None:
    one = tuning_with(since.k_p, since.k_i)
    for dt in dts:
        before = one.state.k_i * integral
        gains, integral = one.follow(ordered(to), dt, integral, 1.0 + 0.0j, AT_PLACE)
        assert cmath.isfinite(integral)
        if to.k_i > 0.0:
            assert cmath.isclose(gains.k_i * integral, before, rel_tol=1e-12, abs_tol=1e-300)
        else:
            assert abs(gains.k_i * integral) <= abs(before)


@given(since=GAINS, to=GAINS, dt=st.floats(0.001, 0.5))
def test_gains_change_at_limited_rate_and_arrive_exactly(since: Tuned, to: Tuned, dt: float) -> None:
    one, steps = tuning_with(since.k_p, since.k_i), 0
    while (one.state.k_p, one.state.k_i) != (to.k_p, to.k_i):
        before, steps = (one.state.k_p, one.state.k_i), steps + 1
        one.follow(ordered(to), dt, 0j, 1.0 + 0.0j, AT_PLACE)
        assert abs(math.log(one.state.k_p / before[0])) <= MAX_GAIN_RATE * dt * (1.0 + 1e-9)
        if before[1] > 1e-3 < one.state.k_i:
            assert abs(math.log(one.state.k_i / before[1])) <= INTEGRAL_RATE_RATIO * MAX_GAIN_RATE * dt * (
                1.0 + 1e-9
            )
        assert steps <= math.log(1e6) / (MAX_GAIN_RATE * dt) + 2
    gains, _ = one.follow(ordered(to), dt, 1j, 1.0 + 0.0j, AT_PLACE)
    assert (gains.k_p, gains.k_i) == (to.k_p, to.k_i)


@given(to=GAINS, split=st.lists(st.floats(0.001, 0.2), min_size=2, max_size=20))
def test_gains_depend_on_time_not_on_message_rate(to: Tuned, split: list[float]) -> None:
    often, once = tuning_with(2.0, 1.0), tuning_with(2.0, 1.0)
    for dt in split:
        often.follow(ordered(to), dt, 0j, 1.0 + 0.0j, AT_PLACE)
    once.follow(ordered(to), sum(split), 0j, 1.0 + 0.0j, AT_PLACE)
    assert math.isclose(often.state.k_p, once.state.k_p, rel_tol=1e-9)
    assert math.isclose(often.state.k_i, once.state.k_i, rel_tol=1e-9) or to.k_i == 0.0


@given(
    since=GAINS, to=GAINS, dt=st.floats(0.0, 1.0), integral=st.complex_numbers(max_magnitude=1e3),
    what=st.builds(Measured, PLANE, PLANE, st.just(2), PLANE), kind=st.sampled_from(sorted(LAWS)),
)  # fmt: skip
def test_changing_gains_never_makes_command_jump(
    since: Tuned, to: Tuned, dt: float, integral: complex, what: Measured, kind: str
) -> None:
    one, limits, heading = (
        tuning_with(since.k_p, since.k_i, kind),
        SIX.robots["robot2"].limits,
        cmath.rect(1.0, 0.7),
    )
    what, law = what if LAWS[kind].feed_forward else what._replace(velocity=0j), LAWS[kind].step
    before, _ = law(integral, heading, what, one.gains, limits, 0.05)
    gains, rescaled = one.follow(ordered(to), dt, integral, heading, what)
    after, _ = law(rescaled, heading, what, gains, limits, 0.05)
    for was, now in zip(limited(before, limits), limited(after, limits), strict=True):
        assert abs(now - was) <= MOST + 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("mission", MISSIONS.values(), ids=MISSIONS)
def test_accepted_gains_cause_no_command_jump(mission: Mission, law: str) -> None:
    """After the start, on the way and in formation; small and large changes, and back at once."""
    fleet, most = changed(mission, law)
    if law != "paper":  # the paper law's integral winds up, and gains wait while a command would jump
        k_p, k_i = mission.under(law).gains
        assert in_force(fleet) == {(float(f"{1.2 * k_p:.6g}"), k_i)}
    print(f"{mission.name}, {law}: {100.0 * most:.1f} % of a limit")
    assert 0.0 < most <= JUMP


def test_restarted_agent_reaches_same_gains() -> None:
    fleet = Fleet.under_way(SIX, 3.0, seed=2, loss=0.1)
    fleet.kill("robot4")
    assert tune(fleet, k_p=3.0, k_i=0.5).ok
    fleet.run(1.0)
    fleet.restart("robot4")
    fleet.run(4.0)
    assert in_force(fleet) == {(3.0, 0.5)}
    assert (fleet.status("robot4").k_p, fleet.status("robot4").k_i) == (3.0, 0.5)
    assert tune(fleet, k_p=SIX.gains.k_p, k_i=0.0).ok
    fleet.run(4.0)
    assert in_force(fleet) == {(SIX.gains.k_p, 0.0)}
    assert fleet.status("robot4").k_p is None


def test_restarted_agent_keeps_gains_and_integral() -> None:
    team, name = driving(PAIR.under("paper"), 6.0), PAIR.followers[-1]
    assert tune(team, k_p=2.5, k_i=0.3).ok
    team.run(4.0)
    team.replace(name, 0.2)
    after = team.agents[name]
    while after.here.stream.state.arrived is None:
        team.run(0.001)
    assert (after.tuning.state.k_p, after.tuning.state.k_i) == (2.5, 0.3)
    assert after.state.integral != 0j


@pytest.mark.parametrize("law", ["field", *slow("paper", "proportional")])
def test_recording_with_gain_changes_verifies_exactly(law: str) -> None:
    fleet = RecordedFleet.under_way(SIX, 2.0, law=law, loss=0.1)
    assert tune(fleet, k_p=3.0, k_i=0.5).ok
    fleet.run(0.5)
    assert tune(fleet, k_p=1.0).ok
    fleet.run(6.0)  # the paper law's gains wait while a command would jump
    assert {k_i for _, k_i in in_force(fleet)} == {0.5}
    assert all_alike(verify(SIX, fleet.record))
    late = [one for one in fleet.record if one[1] > EPOCH + 2.2]  # starts with a state traced on the way
    later = verify(SIX, late)
    assert all(one.exact == one.compared > 0 for one in later.values())


@pytest.mark.parametrize(
    "gains", [Tuned(k_p=60.0, k_i=1.0), Tuned(k_p=2.0, k_i=50.0), Tuned(k_p=1000.0, k_i=1000.0)]
)
def test_order_with_unbearable_gains_is_refused(gains: Tuned) -> None:
    orders = Orders(SIX.under("paper"))
    forged = Order(term=1, beat=1, mode="run", shape="hexagon", tuned=gains)
    with pytest.raises(BadMessage, match="unbearable gains"):
        orders.receive(forged, "robot1", 0.0, Now(0.0, EPOCH))
    assert orders.newest is None


@pytest.mark.parametrize(
    "result", ['{"k_p":-1.0,"k_i":1.0}', '{"k_p":1e9,"k_i":1.0}', '{"k_p":0.0,"k_i":1.0}']
)
def test_order_with_invalid_gains_is_not_decoded(result: str) -> None:
    whole = f'{{"term":1,"beat":1,"mode":"run","shape":"hexagon","tuned":{result}}}'
    with pytest.raises(BadMessage, match=r"Order: tuned\.k_p"):
        decode(Order, whole.encode())
