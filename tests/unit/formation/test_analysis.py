from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest

from formation.control.laws import LAWS
from formation.control.unicycle import Command
from formation.mission.file import load, shipped
from formation.mission.graph import Graph, cyclic_core
from formation.mission.model import Mission
from formation.simulation import simulate as simulation
from formation.simulation.compiled import AVAILABLE, LawError
from formation.simulation.edges import Edges
from formation.simulation.simulate import simulate
from formation.stability import feasibility, landmarks, spectrum
from formation.stability.analysis import analyse
from tests.support.missions import with_robots
from tests.support.seeing import hexagon
from tests.unit.formation import scenarios

KEYS = {
    *("ok", "problems", "warnings", "eigenvalues", "stable", "slowest_mode"),
    *("settling_time_estimate", "delay_margin", "depth", "amplification"),
}


def state_matrix(graph: Graph, k_p: float, k_i: float) -> np.ndarray[Any, Any]:
    """Matrix of Eq. (11), unsaturated: d[δ, ξ] = [[-k_P L, -k_I], [L, 0]] [δ, ξ]; shape (2(n-1), 2(n-1))."""
    among = Edges(graph).follower_laplacian()
    return np.block([[-k_p * among, -k_i * np.eye(len(among))], [among, np.zeros_like(among)]])


def random_graph(rng: np.random.Generator) -> Graph:
    size = int(rng.integers(3, 14))
    neighbours: list[tuple[int, ...]] = [()]
    for i in range(1, size):
        others = np.flatnonzero(rng.random(size) < rng.choice([0.02, 0.06, 0.2]))
        # a ring with one entry has complex eigenvalues
        behind = size - 1 if i == 1 else i - 1
        neighbours.append(tuple(sorted({*others.tolist(), behind, 0 if i == 1 else behind} - {i})))
    return Graph(tuple(neighbours))


def test_closed_form_stability_matches_eigenvalues_on_random_graphs() -> None:
    rng, verdicts = np.random.default_rng(1), []
    for _ in range(200):
        graph, k_p, k_i = random_graph(rng), rng.uniform(0.2, 3.0), rng.uniform(0.1, 8.0)
        mu = spectrum.laplacian(graph)
        numerically = np.linalg.eigvals(state_matrix(graph, k_p, k_i))
        verdicts.append(spectrum.stable(mu, k_p, k_i))
        assert verdicts[-1] == (numerically.real.max() < 0.0)
        poles = spectrum.poles(mu, k_p, k_i)
        assert poles.real.max() == pytest.approx(numerically.real.max(), abs=1e-4)
    assert 20 < sum(verdicts) < 180  # both verdicts occur often


@pytest.mark.usefixtures("paper_law_not_simulated")
def test_ring_of_twelve_is_unstable_and_ten_stable() -> None:
    twelve, ten = (analyse(scenarios.ring(size).under("paper")) for size in (12, 10))
    assert (twelve.stable, twelve.ok, ten.stable, ten.ok) == (False, False, True, True)
    assert (twelve.slowest_mode, ten.slowest_mode) == pytest.approx((0.032, -0.070), abs=1e-3)
    # the bound that the problem names is the greatest stable k_i
    bound = float(twelve.problems[0].split("k_i must be below ")[1].split()[0])
    mu = spectrum.laplacian(scenarios.ring(12).graph)
    assert spectrum.stable(mu, 2.0, 0.99 * bound)
    assert not spectrum.stable(mu, 2.0, 1.01 * bound)


def test_poles_solve_their_equation_two_per_eigenvalue() -> None:
    mu = spectrum.laplacian(scenarios.ring(9).graph)
    poles = spectrum.poles(mu, 1.5, 0.7)
    twice = np.concatenate([mu, mu])
    assert poles**2 + 1.5 * twice * poles + 0.7 * twice == pytest.approx(0.0, abs=1e-9)
    assert spectrum.poles(mu, 1.5, 0.0) == pytest.approx(-1.5 * mu)


def test_robot_outside_cycles_contributes_its_degree_as_eigenvalue() -> None:
    chain = scenarios.long_chain(50).graph
    assert cyclic_core(chain) == ()
    assert spectrum.laplacian(chain).tolist() == [1.0] * 50
    # 1 is before the cycle 2-3, 4 behind it
    mixed = Graph(((), (0,), (1, 3), (2,), (2, 3, 0)))
    assert cyclic_core(mixed) == (2, 3)
    dense = np.linalg.eigvals(Edges(mixed).follower_laplacian())
    assert np.sort(spectrum.laplacian(mixed).real) == pytest.approx(np.sort(dense.real))


def test_delay_margin_of_one_follower_matches_theory() -> None:
    k_p, k_i = 2.0, 1.0
    omega = math.sqrt((k_p**2 + math.sqrt(k_p**4 + 4.0 * k_i**2)) / 2.0)
    margin = spectrum.delay_margin(np.array([1.0 + 0j]), k_p, k_i)
    assert margin == pytest.approx(math.atan(k_p * omega / k_i) / omega)


def oscillates(graph: Graph, k_p: float, k_i: float, delay: float) -> bool:
    """Whether the PI loop with a delayed measurement grows, by stepping the delay equation."""
    dt = delay / 40.0
    among = Edges(graph).follower_laplacian()
    late = [np.linspace(1.0, 0.5, len(among))] * 41
    integral = np.zeros(len(among))
    size = []
    for _ in range(int(150.0 / dt)):
        error = -among @ late.pop(0)
        late.append(late[-1] + dt * (k_p * error + k_i * integral))
        integral = integral + dt * error
        size.append(float(np.abs(late[-1]).max()))
    third = len(size) // 3
    return max(size[-third:]) > max(size[third:-third])


@pytest.mark.parametrize("mission", [scenarios.six(), scenarios.ring(6)], ids=["acyclic", "ring"])
def test_loop_oscillates_only_beyond_delay_margin(mission: Mission) -> None:
    margin = spectrum.delay_margin(spectrum.laplacian(mission.graph), 2.0, 0.5)
    assert not oscillates(mission.graph, 2.0, 0.5, 0.9 * margin)
    assert oscillates(mission.graph, 2.0, 0.5, 1.1 * margin)


def test_amplification_grows_from_first_hop_to_tenth() -> None:
    peaks = spectrum.amplification(scenarios.long_chain(10).graph, 2.0, 1.0, None)
    assert peaks[0] == pytest.approx(0.5, rel=1e-3)
    assert 3.0 < peaks[9] / peaks[0] < 4.0
    assert np.all(np.diff(peaks) > 0.0)


def test_feed_forward_cuts_peak_amplification_below_a_quarter() -> None:
    graph = scenarios.six().graph
    without, fed = (spectrum.amplification(graph, 2.0, 1.0, share) for share in (None, 0.1))
    assert fed.max() < 0.25 * without.max()


def test_acyclic_and_cyclic_amplification_solvers_agree() -> None:
    graph = scenarios.six().graph
    s = np.array(1j * np.logspace(-2.0, 1.0, 9), dtype=np.complex128)
    control, forward = 2.0 + 1.0 / s, 1.0 / (1.0 + 0.1 * s)
    for mean in (False, True):
        one = spectrum._solve_acyclic(graph, s, control, forward, mean=mean)
        other = spectrum._solve_cyclic(graph, s, control, forward, mean=mean)
        assert one == pytest.approx(other, abs=1e-12)


def test_oscillating_leader_causes_at_most_the_amplification_peak() -> None:
    """Steps the linear loop of Eq. (7) at one frequency."""
    graph = scenarios.long_chain(4).graph
    among, omega, dt = Edges(graph).follower_laplacian(), 1.0, 1e-3
    away, integral, worst = np.zeros(4), np.zeros(4), np.zeros(4)
    for k in range(60_000):
        error = -among @ away
        away = away + dt * (2.0 * error + integral - np.cos(omega * k * dt))
        integral = integral + dt * error
        if k > 40_000:
            worst = np.maximum(worst, np.abs(error))
    peaks = spectrum.amplification(graph, 2.0, 1.0, None)
    assert np.all(worst < 1.01 * peaks)
    assert worst[0] == pytest.approx(peaks[0], rel=0.01)  # the first hop peaks at √k_I


@pytest.mark.slow
@pytest.mark.parametrize("name", shipped())
@pytest.mark.parametrize("law", ["field", "paper"])
def test_predicted_settling_time_is_near_that_of_random_starts(name: str, law: str) -> None:
    mission = load(name)
    predicted = analyse(mission.under(law)).settling_time_estimate
    median = simulate(mission, runs=30, law=law, horizon=80.0).summary()["settling_time"]["median"]
    assert predicted is not None
    assert 0.4 < predicted / median < 2.0  # convoy's own starts are nearer to the slots than random ones


@pytest.mark.usefixtures("paper_law_not_simulated")
@pytest.mark.parametrize(
    ("mission", "stable"), [(load("six_robots"), True), (scenarios.ring(12).under("paper"), False)]
)
def test_analysis_json_has_null_for_values_of_unstable_mission(mission: Mission, *, stable: bool) -> None:
    found = analyse(mission).as_json()
    assert set(found) >= KEYS
    assert json.loads(json.dumps(found, allow_nan=False))["robots"] == len(mission.names)
    assert found["stable"] is stable
    assert (found["settling_time_estimate"] is None) is not stable
    assert (set(found["amplification"].values()) == {None}) is not stable
    assert (found["delay_margin"] == 0.0) is not stable


def changed(mission: Mission, **tables: Any) -> Mission:
    """The mission with changed tables, validated anew."""
    data = mission.model_dump(exclude_none=True)
    for robot in data["robots"].values():
        robot.update(tables.get("robot", {}))
    for key in tables.keys() - {"robot"}:
        data[key] = (data.get(key) or {}) | tables[key] if isinstance(tables[key], dict) else tables[key]
    return Mission.model_validate(data)


PAIR = scenarios.pair()


@pytest.mark.usefixtures("paper_law_not_simulated")
@pytest.mark.parametrize(
    ("mission", "result"),
    [
        (
            changed(PAIR, route=[{"radius": 0.04, "speed": 0.05}]),
            ["0.radius = 0.04 m", "control_point_offset of robot2, robot3", "above 0.05 m"],
        ),
        (
            changed(PAIR, route=[{"radius": 0.06, "speed": 0.2}]),
            ["turns at 3.33 rad/s", "robot2, robot3", "at most 2.84 rad/s"],
        ),
        (
            changed(PAIR, simulated_robot={"max_speed": 0.04}),
            ["route.0.speed = 0.05 m/s", "cannot keep up", "below 0.04 m/s"],
        ),
        (
            changed(PAIR, shapes={"shape": {"robot2": (0.3, 0.0), "robot3": (0.3, 0.1)}}),
            ["shapes.shape", "robot2 and robot3 are 0.1 m apart", "over 0.2 m"],
        ),
        (
            changed(PAIR, robot={"rate": 1.0}, law={"gain": 2.5}),
            ["robots.robot2.rate = 1 Hz", "law.gain = 2.5", "must be above"],
        ),
        (
            changed(PAIR, law={"kind": "paper", "k_p": 1e-6, "k_i": 1e6}),
            ["robots.robot2.rate", "no rate is enough"],
        ),
    ],
)
def test_problem_names_robots_keys_values_and_legal_values(mission: Mission, result: list[str]) -> None:
    found = analyse(mission)
    assert not found.ok
    assert any(all(part in problem for part in result) for problem in found.problems), found.problems


@pytest.mark.usefixtures("paper_law_not_simulated")
@pytest.mark.parametrize(
    ("mission", "result"),
    [
        (scenarios.near_limit(), "to catch up by a metre takes 50 s"),
        (scenarios.long_chain(10).under("paper"), "errors grow along the graph: robot11, 10 hops"),
        (changed(PAIR, simulated_robot={"max_speed": 0.2}), "max_speed of robot2, robot3 is above"),
        (changed(PAIR, robot={"max_speed": 210.0}), "is 210 m/s, usual is at most 5 m/s: check its unit"),
        (changed(PAIR, robot={"rate": 5.0}, law={"gain": 4.0}), "delay margin"),
        (changed(load("six_robots"), simulation={"horizon": 2.0}), "does not settle within 2 s"),
        (
            changed(PAIR, robot={"measurement": "local"}, cohesion={"error": 0.3}),
            "robot2, robot3 have measurement",
        ),
    ],
)
def test_analysis_warns_of_mission_that_works_badly(mission: Mission, result: str) -> None:
    assert any(result in warning for warning in analyse(mission).warnings)


@pytest.mark.usefixtures("paper_law_not_simulated")
def test_sampled_loop_is_stable_only_above_named_rate() -> None:
    mission = changed(PAIR, robot={"rate": 1.0}, law={"kind": "paper", "k_p": 2.5})
    (problem,) = analyse(mission).problems
    needed = float(problem.split("above ")[1].split()[0])
    mu = spectrum.laplacian(mission.graph)
    assert spectrum.sampled_radius(mu, 2.5, 0.2, 1.0 / (1.02 * needed)) < 1.0
    assert spectrum.sampled_radius(mu, 2.5, 0.2, 1.0 / (0.98 * needed)) > 1.0


def test_loop_without_integral_is_judged_by_k_p(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("formation.stability.analysis.settling_time", lambda *_: 1.0)  # compiles no law
    for law in ("paper", "proportional"):
        assert analyse(changed(PAIR, law={"kind": law, "k_i": 0.0})).problems == ()
        slow = changed(PAIR, robot={"rate": 1.0}, law={"kind": law, "k_p": 2.5, "k_i": 0.0})
        (problem,) = analyse(slow).problems
        assert "too low for law.k_p" in problem


def test_unreachable_explains_each_robot_without_path_to_leader() -> None:
    apart = Graph(((), (0,), (3,), (2,), ()))
    reasons = feasibility.unreachable(apart, ("leader", "a", "b", "c", "d"))
    assert reasons == {
        "b": "its neighbours lead only to c",
        "c": "its neighbours lead only to b",
        "d": "it measures no robot",
    }


SEES = {"measurement": "scan", "scanner": "required"}


@pytest.mark.parametrize(
    "mission", [hexagon(), load("posts")], ids=["one by odometry", "without scan measurement"]
)
def test_missions_that_need_no_landmark_have_no_warning(mission: Mission) -> None:
    assert list(landmarks.warnings(mission)) == []


def test_landmark_warning_names_robots_without_landmark() -> None:
    (warning,) = landmarks.warnings(with_robots("posts", **SEES))
    assert warning.startswith("robot1, robot2: have no neighbour that is nearer to the leader")


def test_landmark_warning_names_neighbour_out_of_range() -> None:
    mission = with_robots("six_robots", **SEES)
    near = mission.simulated_scanner.model_copy(update={"range_max": 0.9})
    found = list(landmarks.warnings(mission.changed(simulated_scanner=near)))
    assert found[0] == (
        "robot3: in shape hexagon its nearest neighbour to be seen is 1.00 m away;"
        " the simulated scanner measures 0.9 m"
    )


@pytest.mark.parametrize("name", ["posts", "six_robots"])
def test_landmarks_form_no_cycle(name: str) -> None:
    mission = with_robots(name, **SEES)
    done: set[str] = set()
    while left := [one for one in mission.followers if one not in done]:
        ready = [one for one in left if set(mission.landmarks_of(one)) <= done]
        assert ready
        done.update(ready)


def _not_finite(integral: complex, *_: Any) -> tuple[Command, complex]:
    return Command(math.nan, 0.0), integral


def _raising(integral: complex, heading: complex, *_: Any) -> tuple[Command, complex]:
    if heading != 0.0:
        raise IndexError("no neighbour")
    return Command(0.0, 0.0), integral


def _no_numbers(integral: complex, *_: Any) -> tuple[Command, complex]:
    return Command(float(json.dumps(1.0)), 0.0), integral


@pytest.mark.slow
def test_law_that_is_not_finite_is_problem(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simulation, "LAWS", {"field": LAWS["field"]._replace(step=_not_finite)})
    found = analyse(load("six_robots"))
    assert found.problems == (
        "law.kind = 'field': simulated, it gives a command or an integral that is not finite",
    )


@pytest.mark.skipif(not AVAILABLE, reason="nothing compiles")
def test_law_that_cannot_be_compiled_is_named_with_its_line() -> None:
    law = LAWS["proportional"]._replace(name="mine", step=_no_numbers)
    with pytest.raises(
        LawError, match=r"the law 'mine' cannot be compiled: test_analysis.py line \d+: .*dumps"
    ):
        simulate(load("six_robots"), law=law, horizon=0.1)


@pytest.mark.slow
@pytest.mark.skipif(not AVAILABLE, reason="nothing compiles")
def test_law_that_raises_is_named() -> None:
    law = LAWS["proportional"]._replace(name="mine", step=_raising)
    with pytest.raises(LawError, match=r"^the law 'mine' raised IndexError: no neighbour$"):
        simulate(load("six_robots"), law=law, horizon=0.1)
