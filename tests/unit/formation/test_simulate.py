"""The simulation: its control loop, its random starts and its results."""

from __future__ import annotations

import cmath
import json
import math
from typing import Any

import numpy as np
import pytest

from formation.control import laws
from formation.control.controller import Measured
from formation.control.laws import LAWS
from formation.control.laws.field import field
from formation.control.observer import Travel
from formation.control.plane import unit
from formation.control.pose_filter import ODOMETRY_NOISE, filtered, first_spread, least_noise
from formation.control.tracker import Track, first_seen, seen
from formation.control.trust import believed, trust
from formation.control.unicycle import advance, control_point
from formation.mission.file import load
from formation.mission.model import Mission
from formation.mission.route import Route
from formation.simulation.ensemble import MIN_START_CLEARANCE, Options, random_starts
from formation.simulation.simulate import DWELL_TIME, simulate
from formation.stability.analysis import analyse
from tests.unit.formation import oracle, scenarios

SIX = scenarios.six()


# Control loop and starts


def test_array_simulation_matches_loop_over_single_robots() -> None:
    mission, step, runs = SIX, 0.02, 2
    first = random_starts(mission, runs, 3.0, np.random.default_rng(np.random.SeedSequence(7).spawn(2)[0]))
    together = simulate(mission, runs=runs, seed=7, horizon=3.0, step=step, keep=True)
    assert together.history is not None
    apart = one_by_one(mission, first.position[0].tolist(), first.heading[0].tolist(), step, 150)
    assert together.history.position[-1, 1:] == pytest.approx(apart, abs=1e-9)


def one_by_one(
    mission: Mission, position: list[complex], heading: list[complex], step: float, steps: int
) -> list[complex]:
    """The field law's closed loop in plain Python: no arrays, one follower at a time; no ramp."""
    route, names, law = Route.of(mission), mission.followers, mission.law
    least = least_noise(mission.collisions.noise)
    filtered_at, spreads = list(position), [first_spread(least)] * len(names)
    specs = [mission.robots[name] for name in names]
    estimate = [mission.first_heading(name) for name in names]
    integral, tracks = [0j] * len(names), [dict[str, Track]() for _ in names]
    for k in range(steps):
        places = {mission.leader: route.position(k * step)}
        for i, name in enumerate(names):
            places[name] = control_point(filtered_at[i], unit(estimate[i]), specs[i].control_point_offset)
        for i, spec in enumerate(specs):
            for other in spec.neighbours:
                last = tracks[i].get(other)
                top = mission.robots[other].top_speed
                tracks[i][other] = (
                    first_seen(k * step, places[other])
                    if last is None
                    else seen(last, k * step, places[other], law.velocity_filter, top)
                )
            facing, mine, leads = unit(estimate[i]), mission.slot(names[i]), mission.leader_speed
            each = [
                trust(tracks[i][other].velocity, leads, mission.robots[other].top_speed)
                for other in spec.neighbours
            ]
            known = [(one, other, tracks[i][other]) for one, other in zip(each, spec.neighbours, strict=True)]
            away = [track.point - places[names[i]] for _, _, track in known]
            desired = [mission.slot(other) - mine for other in spec.neighbours]
            velocity = sum(one.weight * track.velocity for one, _, track in known)
            measured = Measured(
                facing.conjugate() * oracle.weighted_mean(each, away),
                oracle.weighted_mean(each, desired),
                1,
                believed(velocity / sum(one.weight for one in each), leads),
            )
            command, integral[i] = field(integral[i], facing, measured, mission.gains, spec.limits, step)
            there, after = advance(position[i], heading[i], *command, step)
            travel = Travel(command.speed * step, command.turn_rate * step, there - position[i])
            position[i], heading[i] = there, after
            filtered_at[i], estimate[i], spreads[i] = filtered(
                filtered_at[i], estimate[i], spreads[i], travel, there, step, least, ODOMETRY_NOISE
            )
    return position


@pytest.mark.slow
def test_same_seed_gives_both_laws_same_starts() -> None:
    paper, field, other = (
        simulate(SIX, runs=5, seed=seed, law=law, horizon=0.1)
        for seed, law in ((3, "paper"), (3, "field"), (4, "field"))
    )
    assert paper.error[0].tolist() == field.error[0].tolist()
    assert paper.error[0].tolist() != other.error[0].tolist()


def test_law_given_as_value_equals_law_by_name() -> None:
    named, given = (simulate(SIX, law=law, runs=3, horizon=2.0) for law in ("field", LAWS["field"]))
    assert given.law == "field"
    assert np.array_equal(named.error, given.error)


def test_random_starts_cover_spread_and_all_headings() -> None:
    starts = random_starts(SIX, 500, 3.0, np.random.default_rng(0))
    away = starts.position + 0.2 * starts.heading - np.array(SIX.slots()[1:])
    for axis in (away.real, away.imag):
        assert -3.0 <= axis.min() < -2.9
        assert 2.9 < axis.max() <= 3.0
    assert abs(starts.heading.mean()) < 0.05
    assert np.abs(starts.heading) == pytest.approx(1.0)
    turned = as_a_whole(load("six_robots"), 90.0)
    starts = random_starts(turned, 20, 0.0, np.random.default_rng(0))
    slots = np.array(turned.slots()[1:]) * turned.leader_heading
    assert starts.position + 0.2 * starts.heading == pytest.approx(np.tile(slots, (20, 1)))


def test_single_run_starts_as_in_mission_and_reports_progress() -> None:
    mission, shares = load("six_robots"), list[float]()
    history = simulate(mission, horizon=0.1, keep=True, progress=shares.append).history
    assert history is not None
    assert history.position[0].tolist() == [mission.robots[name].start.position for name in mission.names]
    assert history.names == mission.names
    assert history.time[-1] == pytest.approx(0.1)
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_summary_is_null_for_unchecked_touching_and_unsettled_runs() -> None:
    found = simulate(SIX, runs=3, horizon=1.0).summary()
    assert SIX.collisions.mode == "off"
    assert (found["touched"], found["nearest"]) == (None, None)
    assert (found["converged_fraction"], found["settling_time"]) == (0.0, {"median": None, "p95": None})
    assert simulate(load("six_robots"), horizon=1.0).summary()["touched"] == 0


def test_random_starts_keep_clearance_between_bodies() -> None:
    crowded = SIX.model_copy(
        update={"robots": {n: one.model_copy(update={"radius": 0.4}) for n, one in SIX.robots.items()}}
    )
    starts = random_starts(crowded, 200, 3.0, np.random.default_rng(0))
    for run in starts.position:
        assert min(abs(a - b) for k, a in enumerate(run) for b in run[:k]) >= 0.8 + MIN_START_CLEARANCE


def test_rotated_mission_settles_like_unrotated_mission() -> None:
    upright, turned = (as_a_whole(load("six_robots"), degrees) for degrees in (0.0, 90.0))
    times = [float(simulate(one, horizon=30.0).settling_time[0]) for one in (upright, turned)]
    assert times[1] == pytest.approx(times[0], abs=0.05)
    assert analyse(turned).settling_time_estimate == pytest.approx(
        analyse(upright).settling_time_estimate, abs=0.1
    )


def as_a_whole(mission: Mission, degrees: float) -> Mission:
    """The mission with a shape that turns with its leader, rotated as a whole by `degrees`."""
    output, turn = mission.model_dump(), cmath.rect(1.0, math.radians(degrees))
    for name, robot in output["robots"].items():
        start = mission.robots[name].start
        place = start.position * turn
        robot["start"] = {"x": place.real, "y": place.imag, "heading_deg": start.heading_deg + degrees}
    for leg in output["route"]:
        leg["heading_deg"] += degrees
    return Mission.model_validate({**output, "turning": True})


# Results


def test_summary_has_expected_keys_and_is_strict_json() -> None:
    found = simulate(SIX, runs=3, horizon=30.0).summary()
    assert set(found) == {
        "runs", "converged_fraction", "settling_time", "touched", "nearest", "deadlocks", "final_error",
        "wall_time", "robot_steps_per_second",
    }  # fmt: skip
    assert set(found["settling_time"]) == {"median", "p95"}
    assert set(found["final_error"]) == {"median", "max"}
    json.dumps(found, allow_nan=False)


def test_run_counts_as_settled_only_after_dwell_time() -> None:
    mission = scenarios.six(gain=0.2)
    settled = float(simulate(mission, horizon=60.0).settling_time[0])
    soon, late = (
        simulate(mission, horizon=settled + DWELL_TIME + more).settling_time[0] for more in (-1.0, 1.0)
    )
    assert settled > DWELL_TIME
    assert math.isnan(soon)
    assert late == pytest.approx(settled)


def test_error_stays_below_bound_after_settling_time() -> None:
    result = simulate(SIX, horizon=20.0)
    before = result.error[result.time < result.settling_time[0], 0]
    after = result.error[result.time >= result.settling_time[0], 0]
    assert before[-1] >= SIX.settled
    assert after.max() < SIX.settled
    assert result.final_error[0] == after[-1]


@pytest.mark.parametrize(
    ("wrong", "output"),
    [
        ({"runs": 0}, "runs = 0: must be at least 1"),
        ({"law": "fast"}, f"must be one of {', '.join(LAWS)}"),
        ({"step": 0.5}, "step = 0.5: must be above 0 and at most 0.2"),
        ({"horizon": math.inf}, "horizon = inf: must be finite"),
        ({"spread": math.nan}, "spread = nan: must be finite"),
    ],
)
def test_error_names_illegal_argument_and_legal_values(wrong: dict[str, Any], output: str) -> None:
    with pytest.raises(ValueError, match=output):
        simulate(SIX, **wrong)


def test_error_says_why_a_law_cannot_be_used(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(laws, "UNUSABLE", {"mine": "mine.py cannot be used: SyntaxError"})
    with pytest.raises(ValueError, match=r"mine\.py cannot be used"):
        simulate(SIX.under("mine"))


@pytest.mark.parametrize(
    ("wrong", "output"), [({"delay": -0.1}, "from 0 to 60 s"), ({"loss": 1.5}, "share from 0 to 1")]
)
def test_option_out_of_range_is_refused(wrong: dict[str, Any], output: str) -> None:
    with pytest.raises(ValueError, match=output):
        Options(**wrong)


@pytest.mark.parametrize(("steps", "kept"), [(1, 2), (999, 1000), (1000, 1001), (1001, 501), (5000, 1001)])
def test_curve_has_at_most_1000_moments_after_start(steps: int, kept: int) -> None:
    result = simulate(SIX, horizon=0.01 * steps, step=0.01)
    assert len(result.error) == kept
    assert result.time[-1] == pytest.approx(0.01 * (steps // 1000 + (steps % 1000 > 0)) * (kept - 1))


def test_curves_of_very_many_runs_have_fewer_moments(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("formation.simulation.simulate.MAX_ALL_MOMENTS", 100)
    assert len(simulate(SIX, runs=20, horizon=1.0, step=0.01).error) == 6
    assert len(simulate(SIX, runs=200, horizon=1.0, step=0.01).error) == 2
