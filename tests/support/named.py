"""Requests that name the stop or the hold that they end, as the programs of an operator make them."""

from __future__ import annotations

from collections.abc import Callable

from formation.protocol.order import OperatorReply, OperatorRequest, decode, encode


def named(request: OperatorRequest, put: Callable[[bytes], bytes]) -> OperatorRequest:
    """`request` with the ids in force at the one that answers `put`; unchanged unless it ends something."""
    if request.do not in {"release", "run"} or request.ends:
        return request
    known = decode(OperatorReply, put(encode(OperatorRequest(do="query"))))
    return request.model_copy(update={"ends": tuple(filter(None, (known.stop, known.hold)))})
