from __future__ import annotations

import json
import math
import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from formation.body import Body
from formation.ensemble import Options
from formation.heading import Travel, innovation
from formation.law import Measured, field
from formation.mission import Mission
from formation.mission_file import load
from formation.neighbour import Track, first_seen, seen
from formation.plane import unit
from formation.route import Route
from formation.simulate import DWELL, Result, simulate
from formation.starts import random_starts
from formation.unicycle import advance, control_point
from tests.formation import scenarios

SIX = scenarios.six()


def median(result: Result) -> float:
    return float(result.summary()["settling_time"]["median"])


def out_of_slot(mission: Mission, result: Result) -> list[float]:
    """Each robot's distance from its slot behind the leader, RMS over the last third of the run [cm]."""
    assert result.history is not None
    points = result.history.points
    away = np.abs(points - points[:, :1] - mission.slots())[len(points) * 2 // 3 :]
    rms: list[float] = (100.0 * np.sqrt(np.square(away).mean(axis=0))).tolist()
    return rms


# Theory's table. `python -m tests.bench.table` makes all of it with 400 starts.


def test_six_robots_settle_six_times_as_fast_by_the_field_law() -> None:
    paper = simulate(SIX, runs=200, law="paper", horizon=90.0)
    field = simulate(SIX, runs=200, law="field", horizon=30.0)
    assert paper.converged.mean() > 0.95
    assert field.converged.all()
    assert median(paper) == pytest.approx(26.6, rel=0.1)
    assert median(field) < 4.4
    assert np.percentile(field.settling_time, 95) < 5.8
    assert median(paper) > 6.0 * median(field)


def test_the_observer_and_anti_windup_alone_settle_in_ten_seconds() -> None:
    plain = scenarios.six(feed_forward=False, delay_compensation=False, integral_band=1e9)
    assert median(simulate(plain, runs=100, horizon=30.0)) == pytest.approx(9.9, rel=0.1)


def test_the_turtlebot_pair_settles_six_times_as_fast_by_the_field_law() -> None:
    pair = scenarios.pair()
    paper = simulate(pair, runs=200, law="paper", horizon=90.0)
    field = simulate(pair, runs=200, law="field", horizon=30.0)
    assert median(paper) == pytest.approx(33.6, rel=0.1)
    assert field.converged.all()
    assert median(field) == pytest.approx(5.0, rel=0.1)


def test_near_the_limit_most_starts_never_settle_by_the_paper_law_and_all_do_by_the_field_law() -> None:
    mission = scenarios.near_limit()
    paper = simulate(mission, runs=200, law="paper")
    field = simulate(mission, runs=30, law="field", horizon=120.0)
    assert paper.converged.mean() <= 0.5
    assert field.converged.all()
    assert median(field) < 48.7 * 1.1


@pytest.mark.parametrize(
    ("delay", "paper_errs", "field_errs"),
    [(0.0, (3.6, 19.0, 45.0), (0.08, 0.38, 0.84)), (0.1, (4.4, 23.0, 55.0), (0.13, 0.7, 1.5))],
)
def test_on_a_circle_the_field_law_errs_fifty_times_less(
    delay: float, paper_errs: tuple[float, ...], field_errs: tuple[float, ...]
) -> None:
    mission = scenarios.circling_chain()
    for law, expected in (("paper", paper_errs), ("field", field_errs)):
        result = simulate(
            mission, law=law, options=Options(delay=delay), horizon=90.0, starts="random", keep=True
        )
        errs = out_of_slot(mission, result)
        for hop, most in zip((1, 5, 11), expected, strict=True):
            assert errs[hop] < 1.1 * most
            assert law == "field" or errs[hop] > 0.9 * most


def test_behind_a_straight_leader_late_samples_cost_the_field_law_nothing() -> None:
    mission, late = scenarios.straight_chain(), Options(delay=0.1)
    errs = {
        law: out_of_slot(
            mission, simulate(mission, law=law, options=late, horizon=90.0, starts="random", keep=True)
        )
        for law in ("paper", "field")
    }
    assert (errs["paper"][1], errs["paper"][11]) == pytest.approx((1.0, 11.0), rel=0.1)
    assert max(errs["field"]) < 0.005


# Errata


def test_the_ring_of_twelve_diverges_and_the_ring_of_ten_settles() -> None:
    known = Options(observer="innovation")  # so that it is the law that is tested, not the first guess
    ten, twelve = (
        simulate(scenarios.ring(size), runs=10, law="paper", spread=0.05, options=known, horizon=80.0)
        for size in (10, 12)
    )
    assert ten.converged.all()
    assert not twelve.converged.any()
    assert np.all(twelve.final_error > 10.0 * twelve.error[0])


def test_by_the_observer_as_printed_hardly_any_start_converges() -> None:
    result = simulate(SIX, runs=50, law="paper", options=Options(observer="printed"), horizon=60.0)
    assert result.converged.mean() < 0.1
    assert np.median(result.final_error) > 20.0


# The loop is the agents' own


def test_the_arrays_do_what_one_robot_after_the_other_does() -> None:
    mission, step, runs = SIX, 0.02, 2
    first = random_starts(mission, runs, 3.0, np.random.default_rng(np.random.SeedSequence(7).spawn(2)[0]))
    together = simulate(mission, runs=runs, seed=7, horizon=3.0, step=step, keep=True)
    assert together.history is not None
    apart = one_by_one(mission, first.position[0].tolist(), first.heading[0].tolist(), step, 150)
    assert together.history.position[-1, 1:] == pytest.approx(apart, abs=1e-9)


def one_by_one(
    mission: Mission, position: list[complex], heading: list[complex], step: float, steps: int
) -> list[complex]:
    """The field law's closed loop in plain Python: no arrays, one follower at a time."""
    route, names, law = Route.of(mission), mission.followers, mission.law
    specs = [mission.robots[name] for name in names]
    estimate = [mission.first_heading(name) for name in names]
    integral, tracks = [0j] * len(names), [dict[str, Track]() for _ in names]
    for k in range(steps):
        places = {mission.leader: route.position(k * step)}
        for i, name in enumerate(names):
            places[name] = control_point(position[i], unit(estimate[i]), specs[i].control_point_offset)
        for i, spec in enumerate(specs):
            for other in spec.neighbours:
                last = tracks[i].get(other)
                top = mission.robots[other].top_speed
                tracks[i][other] = (
                    first_seen(k * step, places[other])
                    if last is None
                    else seen(last, k * step, places[other], law.velocity_filter, top)
                )
            known = [tracks[i][other] for other in spec.neighbours]
            facing, mine = unit(estimate[i]), mission.slot(names[i])
            measured = Measured(
                facing.conjugate() * sum(track.point - places[names[i]] for track in known),
                sum(mission.slot(other) - mine for other in spec.neighbours),
                len(known),
                sum(track.velocity for track in known) / len(known),
            )
            command, integral[i] = field(integral[i], facing, measured, law.gains, spec.limits, step)
            there, after = advance(position[i], heading[i], *command, step)
            travel = Travel(command.speed * step, command.turn_rate * step, there - position[i])
            position[i], heading[i] = there, after
            estimate[i] = innovation(estimate[i], travel, law.observer_gain)
    return position


def test_both_laws_get_the_same_starts_for_one_seed_and_others_for_another() -> None:
    paper, field, other = (
        simulate(SIX, runs=5, seed=seed, law=law, horizon=0.1)
        for seed, law in ((3, "paper"), (3, "field"), (4, "field"))
    )
    assert paper.error[0].tolist() == field.error[0].tolist()
    assert paper.error[0].tolist() != other.error[0].tolist()


def test_random_starts_are_within_the_spread_of_their_slots_and_look_everywhere() -> None:
    starts = random_starts(SIX, 500, 3.0, np.random.default_rng(0))
    away = control_point(starts.position, starts.heading, 0.2) - SIX.slots()[1:]
    for axis in (away.real, away.imag):
        assert -3.0 <= axis.min() < -2.9
        assert 2.9 < axis.max() <= 3.0
    assert abs(starts.heading.mean()) < 0.05
    assert np.abs(starts.heading) == pytest.approx(1.0)


def test_a_single_run_starts_as_the_mission_says() -> None:
    mission = load("six_robots")
    history = simulate(mission, horizon=0.1, keep=True).history
    assert history is not None
    assert history.position[0].tolist() == [mission.robots[name].start.position for name in mission.names]
    assert history.names == mission.names
    assert history.time[-1] == pytest.approx(0.1)


# What is reported


def test_the_summary_has_the_keys_of_the_command_and_no_infinities() -> None:
    found = simulate(SIX, runs=3, horizon=30.0).summary()
    assert set(found) == {
        *("runs", "converged_fraction", "settling_time"),
        *("final_error", "wall_time", "robot_steps_per_second"),
    }
    assert set(found["settling_time"]) == {"median", "p95"}
    assert set(found["final_error"]) == {"median", "max"}
    json.dumps(found, allow_nan=False)


def test_where_nothing_converged_settling_times_are_null() -> None:
    found = simulate(SIX, runs=3, horizon=1.0).summary()
    assert found["converged_fraction"] == 0.0
    assert found["settling_time"] == {"median": None, "p95": None}


def test_a_run_has_to_stay_settled_for_the_dwell_time() -> None:
    mission = load("six_robots")
    settled = float(simulate(mission, law="paper", horizon=60.0).settling_time[0])
    soon, late = (
        simulate(mission, law="paper", horizon=settled + DWELL + more).settling_time[0]
        for more in (-1.0, 1.0)
    )
    assert settled > DWELL
    assert math.isnan(soon)
    assert late == pytest.approx(settled)


def test_the_settling_time_is_when_the_error_went_under_the_bound_for_good() -> None:
    result = simulate(SIX, horizon=20.0)
    before = result.error[result.time < result.settling_time[0], 0]
    after = result.error[result.time >= result.settling_time[0], 0]
    assert before[-1] >= SIX.settled
    assert after.max() < SIX.settled
    assert result.final_error[0] == after[-1]


def test_progress_is_told_and_ends_at_one() -> None:
    shares: list[float] = []
    simulate(SIX, horizon=2.0, progress=shares.append)
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"runs": 0}, "runs = 0: must be at least 1"),
        ({"law": "fast"}, "must be one of field, paper"),
        ({"step": 0.5}, "step = 0.5: must be above 0 and at most 0.2"),
        ({"horizon": math.inf}, "horizon = inf: must be finite"),
        ({"spread": math.nan}, "spread = nan: must be finite"),
    ],
)
def test_an_argument_out_of_range_is_named_with_what_is_legal(wrong: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        simulate(SIX, **wrong)


@pytest.mark.parametrize(
    ("wrong", "said"), [({"delay": -0.1}, "from 0 to 60 s"), ({"loss": 1.5}, "share from 0 to 1")]
)
def test_an_option_out_of_range_is_refused(wrong: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        Options(**wrong)


# A worse world


def test_lost_samples_slow_the_formation_down_but_do_not_break_it() -> None:
    result = simulate(SIX, runs=20, horizon=40.0, options=Options(loss=0.3))
    assert result.converged.all()
    assert 3.0 < median(result) < 8.0


def test_who_hears_nothing_stands_still() -> None:
    result = simulate(SIX, horizon=5.0, options=Options(loss=1.0), keep=True)
    assert result.history is not None
    deaf = result.history.time > 0.2
    assert np.abs(result.history.speed[deaf]).max() == 0.0
    assert np.abs(result.history.turn_rate[deaf]).max() == 0.0


def test_delay_compensation_is_what_makes_late_samples_cost_nothing() -> None:
    late = Options(delay=0.1)
    with_it = simulate(scenarios.straight_chain(), options=late, horizon=40.0)
    without = simulate(scenarios.straight_chain(delay_compensation=False), options=late, horizon=40.0)
    assert with_it.final_error[0] < 1e-3
    assert without.final_error[0] > 0.01


def test_positions_that_are_older_than_can_be_believed_are_not_carried_forward() -> None:
    result = simulate(scenarios.straight_chain(), options=Options(delay=0.3), horizon=60.0, keep=True)
    # 0.1 m/s for 0.3 s, each hop
    assert out_of_slot(scenarios.straight_chain(), result)[1] == pytest.approx(3.0, rel=0.1)


def test_a_sensor_on_the_robot_minds_neither_delay_nor_loss() -> None:
    seen_locally = Options(measurement="local")
    deaf = replace(seen_locally, delay=0.5, loss=1.0)
    clean, worse = (simulate(SIX, runs=3, horizon=20.0, options=options) for options in (seen_locally, deaf))
    assert worse.final_error.tolist() == clean.final_error.tolist()
    assert clean.converged.all()


def test_equation_7_as_it_stands_fails_from_most_starts() -> None:
    printed = Options(measurement="local", normalised=False)
    assert simulate(SIX, runs=60, law="paper", options=printed, horizon=90.0).converged.mean() < 0.5


def test_noise_leaves_an_error_of_its_own_size() -> None:
    noisy = Options(body=Body(position_noise=0.001))
    result = simulate(SIX, runs=10, horizon=20.0, options=noisy)
    assert result.converged.all()
    assert 1e-3 < np.median(result.final_error) < 0.03


def test_the_firmware_of_the_mission_clamps_lags_and_cuts_commands() -> None:
    history = simulate(load("turtlebot3_pair"), horizon=30.0, keep=True).history
    assert history is not None
    assert np.abs(history.speed).max() <= 0.2108
    assert 0.0 < history.speed[1].max() < 0.05  # from rest, wheels that lag
    free = simulate(load("turtlebot3_pair"), horizon=30.0, keep=True, options=Options(body=Body())).history
    assert free is not None
    assert np.abs(free.speed[1]).max() > 0.2  # at once


def test_a_run_that_leaves_the_numbers_has_not_converged_and_warns_nobody() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        result = simulate(
            SIX, runs=4, law="paper", horizon=60.0, options=Options(observer="printed", normalised=False)
        )
    assert not result.converged.any()
    json.dumps(result.summary(), allow_nan=False)


def test_ten_thousand_robots_are_steps_of_arrays() -> None:
    side = 100
    grid = -(np.arange(side * side) % side) - 1j * (np.arange(side * side) // side)
    grid = grid.astype(np.complex128)
    behind = [() if i == 0 else (i - 1 if i % side else i - side,) for i in range(side * side)]
    result = simulate(scenarios.build(grid, behind), horizon=1.0, step=0.05)
    assert result.robot_steps == 20 * (side * side - 1)
    assert result.wall_time < 5.0
