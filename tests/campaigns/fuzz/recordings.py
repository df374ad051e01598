"""Damaged recordings, given to everything that reads one: report, recover, replay and verify.

What is allowed: a result, or a refusal in one line. Anything else that is raised is a finding, and so is a
file that keeps a reader busy for longer than `MAX_SECONDS`.
"""

from __future__ import annotations

import argparse
import io
import json
import random
import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.opcode import Opcode
from mcap.records import Chunk, Metadata

from formation.deploy.recordings import recover, replay, report, verify
from formation.deploy.refusal import Refusal
from formation.mission.file import load
from formation.mission.file import read as mission_text
from formation.monitor.recording.part import packed
from formation.monitor.recording.reader import Recording, UnreadableError
from formation.monitor.recording.scan import MAGIC, records, understood
from formation.monitor.replay.player import MAX_SPEED, Player
from formation.monitor.replay.process import Picture
from formation.monitor.web import frames
from formation.wire import Now
from tests.campaigns.fuzz.trying import NUMBERS, Tried, attempt, changed, damaged
from tests.support.recorded import RecordedFleet
from tests.support.recordings import START, record

WHOLE = 200
"""Of so many forms one is drawn as a page; the others are read and judged only."""
SECONDS = 2.0
"""Length of the run that is recorded first [s]."""
_HEAD = struct.Struct("<BQ")
Parts = list[tuple[int, bytes]]
"""Opcode and body of each record."""


def original(folder: Path) -> bytes:
    """A short run of the smallest shipped mission, as the monitor records it."""
    fleet = RecordedFleet(load("turtlebot3_pair"))
    fleet.run(SECONDS)
    result = [sample._replace(arrived=sample.arrived + START) for sample, _ in fleet.record]
    path = folder / "original.mcap"
    record(path, result, mission_text("turtlebot3_pair")[0])
    return path.read_bytes()


class Mutations:
    """Damaged forms of one recording. The same seed gives the same form."""

    def __init__(self, folder: Path) -> None:
        self.original = original(folder)
        with (folder / "original.mcap").open("rb") as file:
            self._parts = [(one.opcode, one.body) for one in records(file)]

    def form(self, seed: int) -> bytes:
        """The recording, damaged."""
        chance = random.Random(seed)
        how: Callable[[Parts, random.Random], None] | None = chance.choice(
            (None, _field, _field, _order, _inside, _inside, _inside, _trace, _trace, _trace, _about, _dense)
        )
        if how is None:
            return damaged(self.original, chance)
        parts = list(self._parts)
        how(parts, chance)
        return _joined(parts)


def _joined(parts: Parts) -> bytes:
    return MAGIC + b"".join(_HEAD.pack(opcode, len(body)) + body for opcode, body in parts) + MAGIC


def _of(parts: Parts, chance: random.Random, opcode: int) -> int:
    """The place of some record of this kind."""
    return chance.choice([at for at, one in enumerate(parts) if one[0] == opcode])


def _field(parts: Parts, chance: random.Random) -> None:
    """A number of any record outside the chunks, the footer's among them."""
    at = _of(parts, chance, chance.choice(list({opcode for opcode, _ in parts})))
    opcode, body = parts[at]
    data, place = bytearray(body), 4 * chance.randrange(1 + min(len(body), 64) // 4)
    data[place : place + 8] = struct.pack("<Q", chance.choice(NUMBERS))
    parts[at] = opcode, bytes(data[: max(len(body), place + 8)])


def _order(parts: Parts, chance: random.Random) -> None:
    """Records that stand elsewhere, twice or nowhere."""
    for _ in range(chance.randint(1, 3)):
        at, to = chance.randrange(len(parts)), chance.randrange(len(parts))
        match chance.randrange(3):
            case 0:
                parts[at], parts[to] = parts[to], parts[at]
            case 1:
                parts.insert(to, parts[at])
            case _:
                del parts[at]


def _inside(parts: Parts, chance: random.Random) -> None:
    """The content of a chunk, whose length and checksum are right all the same."""
    _rewrite(parts, chance, lambda raw: damaged(raw, chance, 8))


def _trace(parts: Parts, chance: random.Random) -> None:
    """A value in the trace of a command; lengths and checksums are right."""

    def rewrite(raw: bytes) -> bytes:
        begins = [at for at in range(len(raw)) if raw.startswith(b'{"n":', at)]
        for begin in chance.sample(begins, min(len(begins), 3)):
            end = raw.find(b"\0", begin)
            try:
                text = json.dumps(changed(json.loads(raw[begin:end]), chance)).encode()
            except ValueError:
                continue
            raw = _with_text(raw, begin, end, text)
        return raw

    _rewrite(parts, chance, rewrite)


def _with_text(raw: bytes, begin: int, end: int, text: bytes) -> bytes:
    """`raw` with another text in the message at `begin`; the lengths around it are adjusted."""
    head = begin - 8 - 31  # CDR head and length, then MCAP's
    if head < 0 or len(text) > 60_000:
        return raw
    length = 22 + 8 + len(text) + 1
    return b"".join((
        raw[:head], _HEAD.pack(Opcode.MESSAGE, length), raw[head + 9 : begin - 4],
        struct.pack("<I", len(text) + 1), text, raw[end:],
    ))  # fmt: skip


def _rewrite(parts: Parts, chance: random.Random, how: Callable[[bytes], bytes]) -> None:
    at = _of(parts, chance, Opcode.CHUNK)
    chunk = understood(Chunk.read, parts[at][1])
    if chunk is not None:
        parts[at] = _chunk(how(lz4.frame.decompress(chunk.data)), chunk, chance.choice(("", "lz4", "zstd")))


def _chunk(raw: bytes, like: Chunk, codec: str) -> tuple[int, bytes]:
    data = {"": bytes, "lz4": lz4.frame.compress, "zstd": zstandard.compress}[codec](raw)
    body = packed(
        Chunk(
            compression=codec, data=data, message_start_time=like.message_start_time,
            message_end_time=like.message_end_time, uncompressed_crc=zlib.crc32(raw),
            uncompressed_size=len(raw),
        )
    )  # fmt: skip
    return int(Opcode.CHUNK), body[_HEAD.size :]


def _about(parts: Parts, chance: random.Random) -> None:
    """What the recording says of itself, the mission among it."""
    at = _of(parts, chance, Opcode.METADATA)
    found = understood(Metadata.read, parts[at][1])
    if found is None:
        return
    key = chance.choice(("mission_file", "mission_file", "law", "part", "recording", "mission"))
    text = damaged(found.metadata.get(key, "1").encode(), chance, 12).decode(errors="replace")
    body = packed(Metadata(name=found.name, metadata={**found.metadata, key: text}))
    parts[at] = int(Opcode.METADATA), body[_HEAD.size :]


def _dense(parts: Parts, chance: random.Random) -> None:
    """A chunk of a few kilobytes that unpacks to many messages without content."""
    many = chance.choice((1_000, 30_000, 300_000, 8_000_000))
    size = 31 * many
    message = struct.pack("<BQHIQQ", Opcode.MESSAGE, 22, chance.choice((0, 1, 2, 9999)), 0, 0, 0)
    like = Chunk("zstd", b"", 2**63, 1, 0, 0)
    if many <= 300_000:
        parts.insert(2, _chunk(message * many, like, chance.choice(("lz4", "zstd"))))
        return
    packer = zstandard.ZstdCompressor().compressobj(size=size)
    data = b"".join([*(packer.compress(message * 10_000) for _ in range(many // 10_000)), packer.flush()])
    body = packed(
        Chunk(
            compression="zstd", data=data, message_start_time=0, message_end_time=1, uncompressed_crc=0,
            uncompressed_size=size,
        )
    )  # fmt: skip
    parts.insert(2, (int(Opcode.CHUNK), body[_HEAD.size :]))


def readers(folder: Path, *, whole_report: bool = True) -> Iterator[tuple[str, Callable[[Path], object]]]:
    """Each command that reads recordings, by its name; without `whole_report` no page is drawn."""
    yield "report", lambda path: _report(path, folder) if whole_report else _gathered(path)
    yield "recover", lambda path: _recover(path, folder)
    yield "replay", _replay
    yield "verify", lambda path: _quiet(verify.main, [str(path), "--verify", "--json"])


def _quiet(main: Callable[[list[str]], int], arguments: list[str]) -> int:
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        return main(arguments)


def _report(path: Path, folder: Path) -> int:
    return _quiet(report.main, [str(path), "-o", str(folder / "report.html"), "--json"])


def _gathered(path: Path) -> None:
    bar: Any = argparse.Namespace(at=lambda _share: None)
    report._gather(report._open(path), bar, (0.0, 1.0))


def _recover(path: Path, folder: Path) -> int:
    out = folder / "recovered.mcap"
    out.unlink(missing_ok=True)
    code = _quiet(recover.main, [str(path), "-o", str(out), "--json"])
    if out.exists():
        assert sum(1 for _ in report._open(out).messages()) >= 0
    return code


def _replay(path: Path) -> None:
    """All of it at once: the clock of the player leaps from message to message."""
    with redirect_stdout(io.StringIO()):
        options = replay._options().parse_args([str(path)])
        one = replay._open(options)
    _played(one.recording, one.film)


def _played(recording: Recording, film: Any) -> None:
    player, picture, mono = Player(film, 0.0, speed=MAX_SPEED), Picture(recording.mission), 0.0
    for _ in range(100_000):
        batch = player.next_batch(mono, 1000)
        for message, _ in batch.due:
            picture.process_message(message)
        if player.finished:
            break
        idle = player.idle(mono)
        mono += max(idle, 0.4 if not batch.due else 0.0)
    at = player.position
    frames.frame(recording.mission, picture.rerun.metrics, Now(at, at))


def tried(folder: Path, seeds: range) -> Iterator[Tried]:
    """Every reader on the form of every seed."""
    mutations, path = Mutations(folder), folder / "mutation.mcap"
    for seed in seeds:
        path.write_bytes(mutations.form(seed))
        for name, read in readers(folder, whole_report=seed % WHOLE == 0):
            yield attempt(name, seed, lambda read=read: read(path), (Refusal, UnreadableError))  # type: ignore[misc]
