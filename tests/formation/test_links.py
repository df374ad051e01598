from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from formation.edges import Edges
from formation.graph import Graph
from formation.neighbour import FORGOTTEN
from formation.simulation.links import Links, Terms

GRAPH = Graph(((), (0,), (0, 1)))
STEP, LIMIT = 0.05, 0.15


def links(**terms: Any) -> Links:
    plain: dict[str, Any] = {
        "step": STEP,
        "delay": 0,
        "loss": 0.0,
        "limit": np.full(3, LIMIT),
        "top_speed": np.full(3, 10.0),
        "time_constant": 0.1,
        "carry": True,
        "local": np.zeros(3, dtype=bool),
    }
    return Links(Edges(GRAPH), Terms(**{**plain, **terms}), np.random.default_rng(0))


def moving(step: int) -> np.ndarray[Any, Any]:
    """One run of three robots side by side, at 1 m/s."""
    return np.array([[0j, 1j, 2j]]) + STEP * step


def test_on_a_perfect_link_the_neighbour_is_where_it_is() -> None:
    perfect = links()
    for step in range(3):
        heard = perfect.hear(step * STEP, moving(step), None)
    assert heard.point.tolist() == moving(2)[:, [0, 0, 1]].tolist()
    assert heard.fresh is None


def test_a_late_sample_is_as_old_as_it_was_told_to_be() -> None:
    late = links(delay=2, carry=False)
    points = [late.hear(step * STEP, moving(step), None).point[0, 0] for step in range(6)]
    assert points == pytest.approx([0.0, 0.0, 0.0, 0.05, 0.10, 0.15])


def test_a_late_sample_of_a_steady_neighbour_is_carried_to_the_present() -> None:
    late = links(delay=2)
    for step in range(60):
        heard = late.hear(step * STEP, moving(step), None)
    assert heard.velocity[0] == pytest.approx([1.0, 1.0, 1.0], abs=1e-6)
    assert heard.point == pytest.approx(moving(59)[:, [0, 0, 1]], abs=1e-6)


def test_where_every_sample_is_lost_nobody_is_fresh_for_longer_than_the_limit() -> None:
    deaf = links(loss=1.0)
    fresh = [deaf.hear(step * STEP, moving(step), None).fresh for step in range(6)]
    assert [bool(one.all()) for one in fresh if one is not None] == [True, True, True, True, False, False]


def test_about_as_many_samples_are_lost_as_asked_for() -> None:
    lossy = links(loss=0.3, carry=False)
    kept = 0
    for step in range(2000):
        heard = lossy.hear(step * STEP, moving(step), None)
        kept += int((heard.point == moving(step)[:, [0, 0, 1]]).sum())
    assert kept / 6000 == pytest.approx(0.7, abs=0.03)


@pytest.mark.parametrize(("silence", "velocity"), [(FORGOTTEN - STEP, 1.0), (FORGOTTEN + STEP, 0.0)])
def test_after_a_long_silence_the_velocity_is_learned_anew(silence: float, velocity: float) -> None:
    link = links(loss=1e-9)
    for step in range(60):
        link.hear(step * STEP, moving(step), None)
    later = 59 + round(silence / STEP)
    heard = link.hear(later * STEP, moving(later), None)
    assert heard.velocity[0] == pytest.approx([velocity] * 3, abs=1e-6)
    assert heard.point == pytest.approx(moving(later)[:, [0, 0, 1]])


def test_what_a_sensor_sees_is_neither_late_nor_lost() -> None:
    local = np.array([False, True, True])
    worse = links(delay=3, loss=1.0, local=local)
    sensed = np.array([[0j, 5.0 + 0j, 6.0 + 0j]])
    for step in range(20):
        heard = worse.hear(step * STEP, moving(step), sensed)
    assert heard.point[0, 1:].tolist() == [5.0, 6.0]
    assert heard.fresh is not None
    assert heard.fresh.tolist() == [[False, True, True]]
