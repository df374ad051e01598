"""A recording read again, message by message in the order of the file; a cut one as far as it goes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, NamedTuple

from mcap.exceptions import McapError
from mcap.records import Channel, Footer, McapRecord, Message, Metadata
from mcap.stream_reader import StreamReader

from formation.mission import Mission
from formation.mission_file import MissionError, parse
from formation.ros2.messages import Text, decode
from formation.wire import BadMessage, Sample
from monitor.recording.attached import SUFFIX

ABOUT = "formation"
"""Name of the metadata record that says what was recorded."""


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
    """What one file says of itself. Its messages are read anew by each call of `messages`."""

    path: Path
    about: Mapping[str, str]
    """Mission, law, versions: the metadata that the recorder wrote."""
    mission: Mission
    """Under the law that was in use."""

    def messages(self) -> Iterator[Recorded]:
        """Every message, attachments included, in the order of recording, up to where the file is cut."""
        channels: dict[int, str] = {}
        attached: dict[str, bytes] = {}
        with self.path.open("rb") as file:
            for record in _records(file):
                if isinstance(record, Channel):
                    channels[record.id] = record.topic.removeprefix("/")
                elif isinstance(record, Message):
                    key = channels[record.channel_id]
                    if key.endswith(SUFFIX):
                        attached[key.removesuffix(SUFFIX)] = _text(record.data)
                        continue
                    wall = record.log_time / 1e9
                    sample = Sample(key, record.data, attached.pop(key, None), wall)
                    yield Recorded(sample, wall, record.log_time)

    def is_cut(self) -> bool:
        """Whether its end is missing: its recorder was killed, or is still at work."""
        with self.path.open("rb") as file:
            return not any(isinstance(record, Footer) for record in _records(file))


def read(path: Path) -> Recording:
    """Open a recording. Raises UnreadableError for what is none."""
    about = _about(path)
    source = f"{path}: its mission"
    try:
        mission = parse(about["mission_file"], source)
    except MissionError as error:
        raise UnreadableError(str(error)) from None
    law = mission.law.model_copy(update={"kind": about.get("law", mission.law.kind)})
    return Recording(path, about, mission.model_copy(update={"law": law}))


def _about(path: Path) -> Mapping[str, str]:
    try:
        with path.open("rb") as file:
            for record in _records(file):
                if (
                    isinstance(record, Metadata)
                    and record.name == ABOUT
                    and "mission_file" in record.metadata
                ):
                    return dict(record.metadata)
    except OSError as error:
        raise UnreadableError(f"{path}: cannot be read: {error.strerror}") from None
    raise UnreadableError(f"{path}: is no recording that `formation` made")


def _records(file: IO[bytes]) -> Iterator[McapRecord]:
    try:
        yield from StreamReader(file).records
    except (McapError, EOFError, ValueError, RuntimeError):  # the rest was never written
        return


def _text(data: bytes) -> bytes:
    try:
        return decode(Text, data).text.encode()
    except BadMessage:
        return b""
