"""Elections: two processes never lead at once, and a standby leads when the leader fails."""

from __future__ import annotations

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from formation.protocol.election import new_term
from tests.campaigns.timings.elections import SCENARIOS, judged
from tests.support.examples import examples, slow
from tests.unit.leader.team import Team, chain

DRIFT = 0.03
FAULTS = (
    "cut", "split", "heal", "freeze", "thaw", "restart", "stand", "stand", "kill", "clock", "network", "twin",
)  # fmt: skip


def led(followers: int = 3, standbys: int = 2, takeover: float = 1.0, seed: int = 0) -> Team:
    """A team in which the leader's own process leads; its clocks run at different rates."""
    team = Team(seed, chain(followers, standbys, takeover, 10.0 / takeover), DRIFT)
    team.run(2.0 * takeover + 1.0)
    assert (team.leaders, [name for name, _ in team.leader_terms]) == (["led"], ["led"])
    return team


def apply_fault(team: Team, fault: str, draw: random.Random) -> None:
    """Apply a fault to random processes, or between them and the rest."""
    some = draw.sample(list(team.processes), draw.randint(1, min(5, len(team.processes))))
    across = {(one, other) for one in some for other in team.processes if other not in some}
    if fault in {"cut", "split"}:
        team.cuts |= across | ({(other, one) for one, other in across} if fault == "split" else set())
    elif fault == "heal":
        team.cuts.clear()
    elif fault == "network":
        team.loss, team.twice = draw.choice((0.0, 0.2, 0.4, 0.6)), draw.choice((0.0, 0.3, 0.6))
        team.slowest = draw.choice((0.01, 0.1, 0.4, 1.5))
    elif fault == "twin":
        team.twin(draw.choice(team.mission.followers))
    for name in some:
        apply_to_process(team, fault, name, draw)


def apply_to_process(team: Team, fault: str, name: str, draw: random.Random) -> None:
    process = team.processes[name]
    if fault == "freeze":
        process.frozen = True
    elif fault == "thaw":
        team.thaw(name)
    elif fault == "restart":
        team.restart(name)
    elif fault == "stand" and name in team.mission.candidates:
        team.stand(name)
    elif fault == "kill":
        process.alive = False
    elif fault == "clock":
        process.wrong += draw.choice((-3600.0, 3600.0))


@pytest.mark.slow
@settings(max_examples=100)
@given(seed=st.integers(0, 2**32), followers=st.integers(1, 5), standbys=st.integers(1, 3))
def test_at_most_one_candidate_leads_under_any_fault(seed: int, followers: int, standbys: int) -> None:
    """`Team.run` fails as soon as two candidates lead at once."""
    draw, team = random.Random(seed), Team(seed, chain(followers, standbys, rate=10.0), DRIFT)
    team.run(1.2)
    for _ in range(draw.randint(5, 30)):
        apply_fault(team, draw.choice(FAULTS), draw)
        team.run(draw.uniform(0.0, 0.8))
    team.heal()
    team.end_twins()
    team.run(8.0)
    agreed = team.leader_terms[-1]
    team.run(2.0)
    assert (team.leaders, team.leader_terms[-1]) == ([agreed[0]], agreed)
    assert {team.agent(name).orders.voter.state.voted_term for name in team.agents} == {agreed[1]}


@examples(30)
@given(seed=st.integers(0, 2**32), followers=st.integers(1, 5), restarted=st.booleans())
def test_standby_never_leads_before_lease_has_ended(seed: int, followers: int, restarted: bool) -> None:
    team = led(followers, seed=seed)
    team.cuts |= {("led", name) for name in (*team.mission.followers, "s0", "s1")}
    for name in team.mission.followers if restarted else ():
        team.restart(name)
    for _ in range(40):
        team.stand("s0")
        team.run(team.tick)
    assert [name for name, _ in team.leader_terms] == ["led", "s0"]


@examples(10)
@given(seed=st.integers(0, 2**32), followers=st.integers(1, 7), takeover=st.sampled_from([0.4, 1.0, 3.0]))
def test_first_standby_leads_within_the_takeover_time(seed: int, followers: int, takeover: float) -> None:
    team = led(followers, 3, takeover, seed)
    team.processes["led"].alive = False
    team.run(takeover + 2.0 * team.tick)
    assert team.leaders == ["s0"]
    team.run(2.0 * takeover)
    assert [name for name, _ in team.leader_terms] == ["led", "s0"]


def test_first_standby_leads_at_once_after_leader_ends() -> None:
    team = led(followers=1)  # others relay a last beat, which binds votes
    team.end("led")
    team.run(0.4)
    assert team.leaders == ["s0"]


def test_candidate_with_minority_never_asks_for_votes() -> None:
    team = led()
    team.cuts |= {(name, "s0") for name in ("led", *team.mission.followers[1:])}
    team.processes["led"].alive = False
    team.run(5.0)
    assert team.leader("s0").candidacy.term == 0
    assert team.leaders == ["s1"]


@pytest.mark.parametrize("takeover", [0.4, 1.0, 3.0])
def test_leader_received_by_no_follower_is_replaced(takeover: float) -> None:
    team = led(takeover=takeover)
    team.cuts = {("led", name) for name in team.mission.followers}
    team.run(4.0 * takeover)
    assert team.leaders == ["s0"]


def test_leader_wins_back_vote_for_leaderless_term() -> None:
    team = led()
    term = new_term(2, team.processes["s1"].now(team.true), 0)
    team.agent("f2").orders.voter.follows(term, team.processes["f2"].now(team.true).mono)
    team.run(2.0)
    assert [name for name, _ in team.leader_terms] == ["led", "led"]
    assert team.leader_terms[-1][1] > term
    assert team.agreed


@pytest.mark.parametrize(
    ("scenario", "seed"),
    [
        *((scenario, 0) for scenario in SCENARIOS),
        *slow(*((scenario, seed) for scenario in SCENARIOS for seed in range(1, 6))),
        ("mixed missions", 94),  # robot reverses direction: false hold for contradictory speeds
        ("wrong clocks", 428),  # robots relay a term half a day ahead: no leader was elected
    ],
)
def test_election_scenario_with_fault_at_random_moment(scenario: str, seed: int) -> None:
    """Some scenarios and seeds of `tests.campaigns.timings.elections`."""
    _, why = judged(scenario, seed)
    assert not why
