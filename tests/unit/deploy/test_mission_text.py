"""A mission's text, edited: what changes, and that nothing else does."""

from __future__ import annotations

import tomllib

import pytest

from formation.deploy.mission_files.assign import Change, edited
from formation.mission.file import load, read, shipped


@pytest.mark.parametrize("name", shipped())
def test_lists_of_shipped_missions_can_be_edited(name: str) -> None:
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


def test_brackets_in_comments_and_strings_are_no_ends_of_lists() -> None:
    text = '[robots.a]\nneighbours = ["b", # ] here\n"c"] # ] there\n[robots.b] # [robots.c]\nx = "]"\n'
    changed = edited(text, [Change("robots", "a", "neighbours", ("c",))])
    assert changed == '[robots.a]\nneighbours = ["c"] # ] there\n[robots.b] # [robots.c]\nx = "]"\n'


def test_inline_and_dotted_tables_are_edited_as_well() -> None:
    inline = '[robots]\na = { neighbours = ["b"] } # one\nb = {}\n'
    changes = [
        Change("robots", "a", "neighbours", ("c",)),
        Change("robots", "a", "fallback_neighbours", ("b",)),
    ]
    changed = edited(inline, changes)
    assert tomllib.loads(changed)["robots"]["a"] == {"neighbours": ["c"], "fallback_neighbours": ["b"]}
    assert changed.endswith("} # one\nb = {}\n")
    dotted = '[robots]\na.neighbours = ["b"] # one\nb.start = 1\n'
    assert edited(dotted, changes[:1]) == '[robots]\na.neighbours = ["c"] # one\nb.start = 1\n'


def test_what_is_added_stays_clear_of_the_next_table() -> None:
    text = '[robots.a]\nneighbours = ["b"]\nstart = 1 # here\n\n# about b\n[robots.b]\n'
    added = edited(text, [Change("robots", "a", "fallback_neighbours", ("c",))])
    assert added == text.replace("start", 'fallback_neighbours = ["c"]\nstart')
    assert edited(added, [Change("robots", "a", "fallback_neighbours", ())]) == text


def test_without_neighbours_nothing_is_added() -> None:
    with pytest.raises(ValueError, match=r"robots\.a\.avoid"):
        edited("[robots.a]\nstart = 1\n", [Change("robots", "a", "avoid", "all")])
