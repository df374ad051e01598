"""What may happen to messages on their way, as `Fleet.meddle` takes it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from formation.protocol import json_message
from formation.protocol.attachment import PositionAttachment
from formation.ros2.messages import decode, encode
from formation.wire import Sample

Meddle = Callable[[Sample], Iterable[Sample]]


def on(key: str, change: Meddle) -> Meddle:
    """Change messages of `key` and no others."""
    return lambda sample: change(sample) if sample.key == key else (sample,)


def lost(key: str) -> Meddle:
    """Lose all messages of `key`."""
    return on(key, lambda _: ())


def altered(key: str, message: type[Any], change: Callable[[Any], Any]) -> Meddle:
    """Replace each `message` of `key` by what `change` returns for it."""
    return on(key, lambda sample: (sample._replace(payload=encode(change(decode(message, sample.payload)))),))


def reordered(key: str, **changes: Any) -> Meddle:
    """Change the orders that come with positions of `key`."""

    def change(sample: Sample) -> tuple[Sample]:
        attached = json_message.decode(PositionAttachment, sample.attachment or b"")
        other = attached.order and attached.order.model_copy(update=changes)
        return (
            sample._replace(attachment=json_message.encode(attached.model_copy(update={"order": other}))),
        )

    return on(key, change)
