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
from contextlib import redirect_stdout
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
from formation.monitor.recording.part import encoded
from formation.monitor.recording.reader import UnreadableError
from formation.monitor.recording.scan import MAGIC, parsed, records
from formation.monitor.replay.player import MAX_SPEED, Player
from formation.monitor.replay.process import Picture
from formation.monitor.web import frames
from formation.wire import Now
from tests.campaigns.fuzz.trying import NUMBERS, Tried, attempt, changed, damaged, quiet
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
    chunk = parsed(Chunk.read, parts[at][1])
    if chunk is not None:
        raw, codec = how(lz4.frame.decompress(chunk.data)), chance.choice(("", "lz4", "zstd"))
        parts[at] = _chunk(raw, codec, chunk.message_start_time, chunk.message_end_time)


def _chunk(raw: bytes, codec: str, begin: int, end: int) -> tuple[int, bytes]:
    data = {"": bytes, "lz4": lz4.frame.compress, "zstd": zstandard.compress}[codec](raw)
    return _packed(codec, data, begin, end, zlib.crc32(raw), len(raw))


def _packed(codec: str, data: bytes, begin: int, end: int, crc: int, size: int) -> tuple[int, bytes]:
    chunk = Chunk(
        compression=codec, data=data, message_start_time=begin, message_end_time=end, uncompressed_crc=crc,
        uncompressed_size=size,
    )  # fmt: skip
    return int(Opcode.CHUNK), encoded(chunk)[_HEAD.size :]


def _about(parts: Parts, chance: random.Random) -> None:
    """What the recording says of itself, the mission among it."""
    at = _of(parts, chance, Opcode.METADATA)
    found = parsed(Metadata.read, parts[at][1])
    if found is None:
        return
    key = chance.choice(("mission_file", "mission_file", "law", "part", "recording", "mission"))
    text = damaged(found.metadata.get(key, "1").encode(), chance, 12).decode(errors="replace")
    body = encoded(Metadata(name=found.name, metadata={**found.metadata, key: text}))
    parts[at] = int(Opcode.METADATA), body[_HEAD.size :]


def _dense(parts: Parts, chance: random.Random) -> None:
    """A chunk of a few kilobytes that unpacks to many messages without content."""
    many = chance.choice((1_000, 30_000, 300_000, 8_000_000))
    message = struct.pack("<BQHIQQ", Opcode.MESSAGE, 22, chance.choice((0, 1, 2, 9999)), 0, 0, 0)
    if many <= 300_000:
        parts.insert(2, _chunk(message * many, chance.choice(("lz4", "zstd")), 1, 2**63))
        return
    size = len(message) * many
    packer = zstandard.ZstdCompressor().compressobj(size=size)
    data = b"".join([*(packer.compress(message * 10_000) for _ in range(many // 10_000)), packer.flush()])
    parts.insert(2, _packed("zstd", data, 0, 1, 0, size))


def readers(folder: Path, *, whole_report: bool = True) -> dict[str, Callable[[Path], object]]:
    """Each command that reads recordings, by its name; without `whole_report` no page is drawn."""
    page = str(folder / "report.html")
    return {
        "report": (lambda path: quiet(report.main, [str(path), "-o", page, "--json"]))
        if whole_report
        else _gathered,
        "recover": lambda path: _recover(path, folder / "recovered.mcap"),
        "replay": _replay,
        "verify": lambda path: quiet(verify.main, [str(path), "--verify", "--json"]),
    }


def _gathered(path: Path) -> None:
    bar: Any = argparse.Namespace(at=lambda _share: None)
    report._gather(report._open(path), bar, (0.0, 1.0))


def _recover(path: Path, out: Path) -> None:
    out.unlink(missing_ok=True)
    quiet(recover.main, [str(path), "-o", str(out), "--json"])
    if out.exists():
        for _ in report._open(out).messages():
            pass


def _replay(path: Path) -> None:
    """All of it at once: the clock of the player leaps from message to message."""
    with redirect_stdout(io.StringIO()):
        one = replay._open(replay._options().parse_args([str(path)]))
    mission = one.recording.mission
    player, picture, mono = Player(one.film, 0.0, speed=MAX_SPEED), Picture(mission), 0.0
    for _ in range(100_000):
        batch = player.next_batch(mono, 1000)
        for message, _ in batch.due:
            picture.process_message(message)
        if player.finished:
            break
        mono += max(player.idle(mono), 0.4 if not batch.due else 0.0)
    at = player.position
    frames.frame(mission, picture.rerun.metrics, Now(at, at))


def tried(folder: Path, seeds: range) -> Iterator[Tried]:
    """Every reader on the form of every seed."""
    mutations, path = Mutations(folder), folder / "mutation.mcap"
    for seed in seeds:
        path.write_bytes(mutations.form(seed))
        for name, read in readers(folder, whole_report=seed % WHOLE == 0).items():
            yield attempt(name, seed, lambda read=read: read(path), (Refusal, UnreadableError))  # type: ignore[misc]
