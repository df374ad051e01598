"""Rules of a recording: its times are those of the run, and its index finds every message."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import MessageIndex

from formation.deploy.rehearsal.engine import EPOCH
from formation.monitor.recording.scan import contents, parsed, records

TIME_TOLERANCE = 1.0
"""Time before or after the run at which a message may be recorded [s]."""


def wrong(path: Path, seconds: float) -> Iterator[str]:
    """Yield what is wrong with a recording of a run of so many `seconds`, in words."""
    missing, least, most = set[tuple[int, int, int]](), math.inf, -math.inf
    with path.open("rb") as file:
        for record in records(file):
            if record.opcode == Opcode.CHUNK and (found := contents(record.body)) is not None:
                if missing:
                    break
                missing = {(one.channel, one.logged, one.at) for one in found.messages}
                least = min([least, *(1e-9 * one.logged - EPOCH for one in found.messages)])
                most = max([most, *(1e-9 * one.logged - EPOCH for one in found.messages)])
            elif record.opcode == Opcode.MESSAGE_INDEX:
                index = parsed(MessageIndex.read, record.body)
                if index is not None:
                    missing -= {(index.channel_id, logged, at) for logged, at in index.records}
    if missing:
        yield f"the index of a chunk does not find {len(missing)} of its messages"
    if least < -TIME_TOLERANCE or most > seconds + TIME_TOLERANCE:
        yield f"recorded from {least:.1f} s to {most:.1f} s of a run of {seconds:.1f} s"
