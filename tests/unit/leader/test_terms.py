"""The newest term on disk: whatever is in the file, the candidate starts."""

from __future__ import annotations

from pathlib import Path

import pytest

from formation.leader.core import Leader
from formation.leader.process import Terms
from formation.mission.file import parse
from tests.unit.leader.leading import CURVED, at


def test_newest_term_is_kept(tmp_path: Path) -> None:
    terms = Terms(tmp_path / "state", "ann")
    assert terms.read() == 0
    terms.save(17, 1.0)
    terms.close()
    assert Terms(tmp_path / "state", "ann").read() == 17


@pytest.mark.parametrize("content", [b"", b"x", b"-1", b"9" * 5000, b"9223372036854775808", b"\xff\x00"])
def test_unreadable_term_counts_as_none(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "ann.term").write_bytes(content)
    assert Terms(tmp_path, "ann").read() == 0


def test_folder_that_cannot_be_written_holds_up_nothing(tmp_path: Path) -> None:
    terms = Terms(tmp_path, "ann")
    (tmp_path / "ann.new").mkdir()
    terms.save(17, 1.0)
    terms.close()
    assert terms.read() == 0


def test_slow_clock_draws_above_the_kept_term() -> None:
    kept = int((1.7e9 + 3600.0) * 1e9)
    leader = Leader(parse(CURVED), known=kept)
    leader.step(at(0.0), [])
    leader.step(at(1.0), [])
    assert leader.leads
    assert leader.term > kept


def test_leader_draws_a_new_term_once_its_clock_is_set_back() -> None:
    leader = Leader(parse(CURVED))
    for mono in (0.0, 1.0):
        leader.step(at(mono)._replace(wall=at(mono).wall + 90_000.0), [])
    before = leader.term
    leader.step(at(1.1), [])
    assert leader.leads
    assert before - leader.term > 80_000 * 10**9
