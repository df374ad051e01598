"""The leader's process: its name, its replies, its log, and the term on disk."""

from __future__ import annotations

import logging
from argparse import Namespace
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, cast

import pytest

from formation.control import laws
from formation.leader.__main__ import _candidate, _run
from formation.leader.core import Leader
from formation.leader.process import TermFile, lead
from formation.mission import model
from formation.mission.file import load, parse, read
from formation.mission.model import Mission
from formation.protocol import json_message
from formation.protocol.request import OperatorReply
from formation.transport.mailbox import Handler
from formation.transport.runtime.process import BadInput, Process, clocks
from formation.wire import Outgoing
from tests.support.fleet import at
from tests.unit.leader.leading import CURVED, listens

SIX, PATROL = load("six_robots"), load("patrol")


class FakeProcess:
    """A process and bus that run a function of the test as their loop."""

    def __init__(self, run: Callable[[Any, FakeProcess], None]) -> None:
        self.bus, self._run, self.clock = self, run, clocks
        self.request: Handler = lambda _, __: b""
        self.sent: list[Outgoing] = []

    def answer(self, _: str, request: Handler) -> None:
        self.request = request

    def send(self, outbox: list[Outgoing]) -> None:
        self.sent += outbox

    def declare(self, _: Leader, check: object = None) -> None: ...

    def ready(self, *_: str) -> None: ...

    def loop(self, core: Any) -> Iterator[float]:
        self._run(core, self)
        yield 0.0


def run_leader(leader: Leader, run: Callable[[Any, FakeProcess], None]) -> None:
    list(lead(leader, cast("Process", FakeProcess(run))))


def test_leader_refuses_law_that_cannot_be_used(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for module in (laws, model):
        monkeypatch.setattr(module, "UNUSABLE", {"mine": "mine.py cannot be used: SyntaxError"})
    mission = tmp_path / "mission.toml"
    mission.write_text(read("six_robots")[0].replace("[law]", '[law]\nkind = "mine"'), encoding="utf-8")
    with pytest.raises(BadInput, match=r"mission.toml: mine.py cannot be used"):
        _run(Namespace(mission=str(mission), standby=None), cast("Any", None))


def test_thawed_leader_checks_leadership_before_answering(monkeypatch: pytest.MonkeyPatch) -> None:
    leader = Leader(parse(CURVED))

    def frozen(core: Any, bus: FakeProcess) -> None:
        now = clocks()
        listens(leader, now.mono - 10.0)
        core.step(now._replace(mono=now.mono - 8.0), ())
        assert leader.leads
        monkeypatch.setattr(leader.candidacy, "_later_rose", True)  # another leader's term has begun
        reply = json_message.decode(OperatorReply, bus.request(b'{"do":"hold"}', clocks().mono))
        assert (reply.ok, reply.leads) == (True, False), "it keeps the hold, and does not lead"
        assert "ann/position" not in {out.key for out in bus.sent}

    run_leader(leader, frozen)


def test_request_before_first_step_sends_nothing() -> None:
    def requested(_: Any, bus: FakeProcess) -> None:
        assert json_message.decode(OperatorReply, bus.request(b'{"do":"stop"}', clocks().mono)).ok
        assert bus.sent == []

    run_leader(Leader(SIX), requested)


def test_leader_logs_start_requests_and_mode_changes(caplog: pytest.LogCaptureFixture) -> None:
    leader = Leader(SIX)

    def run(core: Any, bus: FakeProcess) -> None:
        now = clocks()
        listens(leader, now.mono - 2.0)
        core.step(now._replace(mono=now.mono - 1.0), ())
        for request in (b'{"do":"shape","shape":"wedge"}', b'{"do":"hold"}'):
            bus.request(request, clocks().mono)
        core.step(clocks(), ())

    with caplog.at_level(logging.INFO):
        run_leader(leader, run)
    result = "\n".join(record.message for record in caplog.records)
    assert "from the start: run" in result
    assert "the operator asked for shape: in shape wedge in " in result
    assert "the operator asked for hold: run to hold" in result


@pytest.mark.parametrize(
    ("mission", "standby", "name"),
    [
        (SIX, None, "robot1"),
        (PATROL, None, "leader"),
        (PATROL, "deputy", "deputy"),
        (PATROL, "reserve", "reserve"),
        (parse(CURVED.replace("[shapes.line]", "[standbys.cat]\n[shapes.line]")), "", "cat"),
    ],
)
def test_candidate_name_follows_from_standby_option(mission: Mission, standby: str | None, name: str) -> None:
    assert _candidate(mission, standby) == name


@pytest.mark.parametrize(
    ("mission", "standby", "why"),
    [
        (SIX, "", r"six-robots has no standbys; list one in the mission: \[standbys.NAME\]"),
        (SIX, "deputy", "six-robots has no standbys"),
        (PATROL, "", "say which one: deputy, reserve"),
        (PATROL, "leader", "must be one of deputy, reserve"),
    ],
)
def test_invalid_standby_is_refused_with_known_names(mission: Mission, standby: str, why: str) -> None:
    with pytest.raises(BadInput, match=why):
        _candidate(mission, standby)


def test_newest_term_is_stored_and_read_again(tmp_path: Path) -> None:
    terms = TermFile(tmp_path / "state", "ann")
    assert terms.read() == 0
    terms.save(17, 1.0)
    terms.close()
    assert TermFile(tmp_path / "state", "ann").read() == 17


@pytest.mark.parametrize("content", [b"", b"x", b"-1", b"9" * 5000, b"9223372036854775808", b"\xff\x00"])
def test_unreadable_term_is_read_as_zero(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "ann.term").write_bytes(content)
    assert TermFile(tmp_path, "ann").read() == 0


def test_failed_term_write_raises_nothing(tmp_path: Path) -> None:
    terms = TermFile(tmp_path, "ann")
    (tmp_path / "ann.new").mkdir()
    terms.save(17, 1.0)
    terms.close()
    assert terms.read() == 0


def test_term_exceeds_stored_term_with_slow_clock() -> None:
    kept = int((1.7e9 + 3600.0) * 1e9)
    leader = Leader(parse(CURVED), known=kept)
    listens(leader)
    leader.step(at(1.0), [])
    assert leader.leads
    assert leader.term > kept


def test_leader_takes_lower_term_after_its_clock_is_set_back() -> None:
    leader = Leader(parse(CURVED))
    listens(leader, -0.1)
    for mono in (0.0, 1.0):
        leader.step(at(mono)._replace(wall=at(mono).wall + 90_000.0), [])
    before = leader.term
    leader.step(at(1.1), [])
    assert leader.leads
    assert before - leader.term > 80_000 * 10**9
