"""Orders, terms and failover of real candidates and agents under random steps.

FORMATION_MODEL_STEPS=200000 pytest tests/unit/leader/test_agreement.py   searches longer, with new seeds.
"""

from __future__ import annotations

import os
from collections import Counter

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule, run_state_machine_as_test

from formation.protocol.request import OperatorRequest
from tests.unit.leader.team import MISSION, TICK, Team

STEPS = int(os.environ.get("FORMATION_MODEL_STEPS", "10000"))
LONG = 100
"""Steps of a run."""
AGREED = 8.0
"""Longest time from the end of all faults until all agents agree [takeovers]."""
TAKEN: Counter[str] = Counter()
ENDS = ("agreed", "gains kept", "leader_terms")
"""Counted at the end of a run; these are no steps."""

NAMES = (*MISSION.candidates, *MISSION.followers)
ONE = st.sampled_from(NAMES)
SOME = st.frozensets(ONE, min_size=1, max_size=4)
CANDIDATE = st.sampled_from(MISSION.candidates)
MEANWHILE = st.integers(0, 4)
GAINS = st.sampled_from([{"k_p": 1.0}, {"k_i": 0.4}, {"k_p": 3.0, "k_i": 1.5}, {"k_p": 50.0}])


class Machine(RuleBasedStateMachine):
    """Every rule is one step, after which some time passes."""

    def __init__(self) -> None:
        super().__init__()
        self.team = Team(0)
        self.requests = 0
        self.request = OperatorRequest(do="hold", id="first")

    @initialize(seed=st.integers(0, 2**32))
    def begin(self, seed: int) -> None:
        self.team = Team(seed)
        self.team.run(3.0)

    def done(self, what: str, meanwhile: int) -> None:
        TAKEN[what] += 1
        self.team.run(meanwhile * TICK)

    @rule(meanwhile=st.integers(0, 20))
    def time_passes(self, meanwhile: int) -> None:
        self.done("time", meanwhile)

    @rule(
        loss=st.sampled_from([0.0, 0.1, 0.3, 0.6]),
        twice=st.sampled_from([0.0, 0.3]),
        slowest=st.sampled_from([0.01, 0.1, 0.5, 2.0]),
        meanwhile=MEANWHILE,
    )
    def network(self, loss: float, twice: float, slowest: float, meanwhile: int) -> None:
        self.team.loss, self.team.twice, self.team.slowest = loss, twice, slowest
        self.done("loss, repetition, delay, reordering", meanwhile)

    @rule(some=SOME, meanwhile=MEANWHILE)
    def partition(self, some: frozenset[str], meanwhile: int) -> None:
        across = {(one, other) for one in some for other in NAMES if other not in some}
        self.team.cuts |= across | {(other, one) for one, other in across}
        self.done("partition", meanwhile)

    @rule(some=SOME, one=ONE, meanwhile=MEANWHILE)
    def deafen(self, some: frozenset[str], one: str, meanwhile: int) -> None:
        self.team.cuts |= {(other, one) for other in some if other != one}
        self.done("deaf", meanwhile)

    @rule(meanwhile=MEANWHILE)
    def join(self, meanwhile: int) -> None:
        self.team.cuts.clear()
        self.done("joined", meanwhile)

    @rule(name=ONE, meanwhile=MEANWHILE)
    def freeze(self, name: str, meanwhile: int) -> None:
        self.team.processes[name].frozen = True
        self.done("freeze", meanwhile)

    @rule(meanwhile=MEANWHILE)
    def thaw(self, meanwhile: int) -> None:
        for name in NAMES:
            self.team.thaw(name)
        self.done("thaw", meanwhile)

    @rule(some=SOME, meanwhile=MEANWHILE)
    def restart(self, some: frozenset[str], meanwhile: int) -> None:
        for name in some:
            self.team.restart(name)
        self.done("restart", meanwhile)

    @rule(name=ONE, meanwhile=MEANWHILE)
    def kill(self, name: str, meanwhile: int) -> None:
        self.team.processes[name].alive = False
        self.done("kill", meanwhile)

    @rule(name=ONE, seconds=st.sampled_from([-3600.0, -10.0, 10.0, 3600.0]), meanwhile=MEANWHILE)
    def set_clock(self, name: str, seconds: float, meanwhile: int) -> None:
        self.team.processes[name].wrong += seconds
        self.done("clock", meanwhile)

    @rule(name=CANDIDATE, meanwhile=MEANWHILE)
    def stand(self, name: str, meanwhile: int) -> None:
        """Skip the wait before a candidacy: that two never lead must not depend on it."""
        self.team.stand(name)
        self.done("stand", meanwhile)

    @rule(name=CANDIDATE, few=st.frozensets(ONE, max_size=2), anew=st.booleans(), calm=st.booleans())
    def overthrow(self, name: str, few: frozenset[str], anew: bool, calm: bool) -> None:
        """Cut off the leader and `few`, restart agents if `anew`, let a candidate ask for votes often."""
        if calm:
            self.team.heal()
            self.team.run(1.5)
        leaders = frozenset(self.team.leaders)
        off = few | leaders
        across = {(one, other) for one in off for other in NAMES if other not in off}
        self.team.cuts |= across | {(other, one) for one, other in across}
        for other in MISSION.followers if anew else ():
            self.team.restart(other)
        for _ in range(15 if name not in leaders else 0):
            self.team.stand(name)
            self.team.run(TICK)
        self.done("overthrow", 0)

    @rule(do=st.sampled_from(["stop", "stop", "release", "hold", "run"]), some=SOME, meanwhile=MEANWHILE)
    def ask(self, do: str, some: frozenset[str], meanwhile: int) -> None:
        self._ask(
            OperatorRequest.model_validate({"do": do, "id": self._id()}), NAMES if do == "stop" else some
        )
        self.done(do, meanwhile)

    @rule(shape=st.sampled_from(sorted(MISSION.shapes)), name=CANDIDATE, meanwhile=MEANWHILE)
    def order_shape(self, shape: str, name: str, meanwhile: int) -> None:
        self._ask(OperatorRequest(do="shape", shape=shape, id=self._id()), (name,))
        self.done("shape", meanwhile)

    @rule(gains=GAINS, name=CANDIDATE, meanwhile=MEANWHILE)
    def tune(self, gains: dict[str, float], name: str, meanwhile: int) -> None:
        self._ask(OperatorRequest.model_validate({"do": "tune", **gains, "id": self._id()}), (name,))
        self.done("tune", meanwhile)

    @rule(age=st.sampled_from([0.1, 1.0, 5.0]), meanwhile=MEANWHILE)
    def ask_again(self, age: float, meanwhile: int) -> None:
        self._ask(self.request.model_copy(update={"age": age}), NAMES)
        self.done("asked again", meanwhile)

    def _id(self) -> str:
        self.requests += 1
        return f"request{self.requests}"

    def _ask(self, request: OperatorRequest, names: frozenset[str] | tuple[str, ...]) -> None:
        self.request = request
        for name in sorted(names):
            self.team.ask(name, request)

    def teardown(self) -> None:
        """Without faults, one candidate leads and all agents obey it."""
        self.team.heal()
        bound = self.team.true + AGREED * MISSION.takeover
        while not self.team.agreed and self.team.true < bound:
            self.team.run(5 * TICK)
        assert self.team.agreed
        self._gains_outlive_the_leader()
        TAKEN["agreed"] += 1
        TAKEN["leader_terms"] += len(self.team.leader_terms)

    def _gains_outlive_the_leader(self) -> None:
        """Gains that all agents have received stay in force under the next leader."""
        bound = self.team.true + AGREED * MISSION.takeover
        while not self._tuned(2.4):
            assert self.team.true < bound
            self._ask(OperatorRequest(do="tune", k_p=2.4, id=self._id()), tuple(self.team.leaders))
            self.team.run(2.0)
        (led,) = self.team.leaders
        tuned = self.team.leader(led).plan.tuned
        self.team.processes[led].alive = False
        bound = self.team.true + AGREED * MISSION.takeover
        self.team.run(MISSION.takeover)
        while not self.team.agreed and self.team.true < bound:
            self.team.run(5 * TICK)
        assert self.team.agreed
        assert self.team.leader(self.team.leaders[0]).plan.tuned == tuned
        TAKEN["gains kept"] += 1

    def _tuned(self, k_p: float) -> bool:
        """Whether one candidate leads and all agents have this k_p from it."""
        newest = [self.team.agent(name).orders.newest for name in MISSION.followers]
        gains = [one.tuned.k_p if one is not None and one.tuned is not None else None for one in newest]
        return self.team.agreed and gains == [k_p] * len(gains)


@pytest.mark.slow
@pytest.mark.timeout(0)
def test_random_steps_keep_one_leader_and_every_stop() -> None:
    TAKEN.clear()
    while (taken := sum(TAKEN.values()) - sum(TAKEN[one] for one in ENDS)) < STEPS:
        run_state_machine_as_test(
            Machine,
            settings=settings(
                max_examples=max(1, round((STEPS - taken) / LONG * 1.1)),
                stateful_step_count=LONG,
                suppress_health_check=list(HealthCheck),
                derandomize="FORMATION_MODEL_STEPS" not in os.environ,
                deadline=None,
            ),
        )
    print(f"{taken} steps: {dict(TAKEN)}")
