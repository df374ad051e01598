"""Arguments of campaigns."""

from __future__ import annotations

import argparse

import pytest

from tests.campaigns.document import one_of

PARTS = argparse.ArgumentParser(exit_on_error=False)
PARTS.add_argument("parts", nargs="*", type=one_of(["crossing", "posts"]))


@pytest.mark.parametrize("words", [[], ["posts"], ["posts", "crossing"]])
def test_any_number_of_parts_is_accepted(words: list[str]) -> None:
    assert PARTS.parse_args(words).parts == words


def test_unknown_part_is_refused_by_name() -> None:
    with pytest.raises(argparse.ArgumentError, match="'post': must be one of crossing, posts"):
        PARTS.parse_args(["post"])
