"""A recording read again, message by message: all its parts in order, a cut one as far as it goes."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, NamedTuple

from mcap.opcode import Opcode
from mcap.records import Channel, Metadata

from formation.law import LAWS
from formation.mission import Mission
from formation.mission_file import MissionError, parse
from formation.wire import Sample
from monitor.recording.attached import SUFFIX, unpacked
from monitor.recording.channels import ABOUT
from monitor.recording.extent import Extent, extent_of
from monitor.recording.rotation import siblings
from monitor.recording.scan import contents, ends_before, footer, records, summary, understood


class UnreadableError(ValueError):
    """A file is no recording of a mission; the text names it and says why."""


class Recorded(NamedTuple):
    """One message of a recording."""

    sample: Sample
    """`arrived` is on the system clock of the recorder here, as `wall`."""
    wall: float
    """When it arrived [s, system clock of the recorder]."""
    ns: int
    """The same [ns]."""


@dataclass(frozen=True)
class Recording:
    """What a recording says of itself. Its messages are read anew by each call of `messages`."""

    path: Path
    """The file that was asked for."""
    about: Mapping[str, str]
    """Mission, law, versions: the metadata that the recorder wrote."""
    mission: Mission
    """Under the law that was in use."""
    parts: tuple[Path, ...]
    """Every file of it that is there, in order."""

    def messages(self, since: float = -math.inf) -> Iterator[Recorded]:
        """Every message of every part, attachments included, up to where one is cut.

        Those before `since` [s, system clock of the recorder] are passed over, by whole chunks, so that some
        of them may still come.
        """
        for part in self.parts:
            with part.open("rb") as file:
                yield from _messages(file, since)

    def is_cut(self) -> bool:
        """Whether the end of a part is missing: its recorder was killed, or is still at work."""
        return not all(map(is_whole, self.parts))

    def extent(self) -> Extent:
        """From when to when it goes, and how many messages there are."""
        return sum((extent_of(part) for part in self.parts), Extent())


def read(path: Path) -> Recording:
    """Open the recording that `path` is a part of. Raises UnreadableError for what is none."""
    about = about_of(path)
    source = f"{path}: its mission"
    try:
        mission = parse(about["mission_file"], source)
    except MissionError as error:
        raise UnreadableError(str(error)) from None
    kind = about.get("law", mission.law.kind)
    if kind not in LAWS:
        raise UnreadableError(f"{path}: its law is {kind[:40]!r}; must be one of {', '.join(LAWS)}")
    law = mission.law.model_copy(update={"kind": kind})
    return Recording(path, about, mission.model_copy(update={"law": law}), _parts(path, about))


def about_of(path: Path) -> Mapping[str, str]:
    """The metadata of one file. Raises UnreadableError."""
    try:
        if path.exists() and not (path.is_file() or path.is_dir()):  # to open a pipe waits for its other end
            raise UnreadableError(f"{path}: must be a file, is a pipe or a device")
        with path.open("rb") as file:
            for record in records(file):
                if record.opcode != Opcode.METADATA:
                    continue
                found = understood(Metadata.read, record.body)
                if found is not None and found.name == ABOUT and "mission_file" in found.metadata:
                    metadata: dict[str, str] = found.metadata
                    return metadata
    except OSError as error:
        raise UnreadableError(f"{path}: cannot be read: {error.strerror}") from None
    raise UnreadableError(f"{path}: is no recording that `formation` made")


def is_whole(path: Path) -> bool:
    """Whether a file was ended as it should."""
    with path.open("rb") as file:
        return footer(file) is not None


def _parts(path: Path, about: Mapping[str, str]) -> tuple[Path, ...]:
    """Every file of the same recording beside `path`; where two are the same part, the one asked for."""
    if "recording" not in about:
        return (path,)
    found = {_number(about): path}
    for other in siblings(path):
        try:
            theirs = about_of(other)
        except UnreadableError:
            continue
        if theirs.get("recording") == about["recording"]:
            found.setdefault(_number(theirs), other)
    return tuple(found[number] for number in sorted(found))


def _number(about: Mapping[str, str]) -> int:
    text = about.get("part", "")
    return int(text) if text.isdecimal() and len(text) < 10 else 1


def _messages(file: IO[bytes], since: float) -> Iterator[Recorded]:
    keys = {} if since == -math.inf else _indexed(file)
    indexed = bool(keys)
    riding: dict[str, bytes] = {}
    for record in records(file):
        if record.opcode == Opcode.CHANNEL:
            _learn(keys, [understood(Channel.read, record.body)])
        if record.opcode != Opcode.CHUNK or (indexed and ends_before(record, since)):
            continue
        if (chunk := contents(record.body)) is None:
            continue
        _learn(keys, chunk.declared)
        if ends_before(record, since):
            continue
        for message in chunk.messages:
            key = keys.get(message.channel, "")
            if key.endswith(SUFFIX):
                riding[key.removesuffix(SUFFIX)] = unpacked(message.data)
            elif key:
                wall = message.logged / 1e9
                sample = Sample(key, message.data, riding.pop(key, None), wall)
                yield Recorded(sample, wall, message.logged)


def _indexed(file: IO[bytes]) -> dict[int, str]:
    """The keys of all channels, from the index at the end; empty where there is none."""
    keys: dict[int, str] = {}
    for record in summary(file):
        if record.opcode == Opcode.CHANNEL:
            _learn(keys, [understood(Channel.read, record.body)])
    return keys


def _learn(keys: dict[int, str], channels: list[Channel] | list[Channel | None]) -> None:
    for channel in channels:
        if channel is not None:
            keys[channel.id] = channel.topic.removeprefix("/")
