"""What a robot's guard answers when it is asked whether it is there."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, ValidationError

from formation.order import Name

LONGEST = 256
"""Longest answer that is read [bytes]."""


class GuardReply(BaseModel):
    """The guard of one robot, and what it is doing."""

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid")
    robot: Name
    state: Literal["listening", "watching", "braking", "parking", "disarmed"]


def encode(reply: GuardReply) -> bytes:
    """As JSON."""
    return reply.model_dump_json().encode()


def decode(data: bytes) -> GuardReply | None:
    """The answer; None for what is none."""
    try:
        return GuardReply.model_validate_json(data) if len(data) <= LONGEST else None
    except ValidationError:
        return None
