"""A mission's text, edited: what changes, and that nothing else does."""

from __future__ import annotations

import tomllib

import pytest

from deploy.making.text import Change, edited
from formation.mission_file import load, read, shipped


@pytest.mark.parametrize("name", shipped())
def test_any_list_of_a_shipped_mission_can_be_set_added_and_taken_out(name: str) -> None:
    text, mission = read(name)[0], load(name)
    for robot in mission.followers:
        for key, value in (
            ("neighbours", ("a", "b")),
            ("fallback_neighbours", ("c",)),
            ("fallback_neighbours", ()),
        ):
            text = edited(text, [Change("robots", robot, key, value)])
            assert tuple(tomllib.loads(text)["robots"][robot].get(key, ())) == value
        for shape in mission.shapes:
            text = edited(text, [Change("shapes", shape, robot, (1.5, -2))])
            assert tomllib.loads(text)["shapes"][shape][robot] == [1.5, -2]


def test_lists_over_several_lines_and_odd_spaces_are_edited_as_well() -> None:
    first, second = "[ robots . a ]  # one\n  neighbours = ", ' # two\n[robots.b]\nneighbours=["a"]'
    text = first + '[\n    "b", # near\n    "c",\n  ]' + second
    changed = edited(text, [Change("robots", "a", "neighbours", ("c",))])
    assert changed == first + '["c"]' + second
    added = edited(text, [Change("robots", "b", "fallback_neighbours", ("c",))])
    assert added.endswith('neighbours=["a"]\nfallback_neighbours = ["c"]')


def test_what_would_come_out_otherwise_than_meant_is_not_written() -> None:
    text = '[robots.a]\nneighbours = ["b", # ] here\n"c"]\n'
    with pytest.raises(ValueError, match=r"robots\.a\.neighbours"):
        edited(text, [Change("robots", "a", "neighbours", ("c",))])
