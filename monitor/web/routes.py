"""The routes of the page's server, and their answers."""

from __future__ import annotations

import asyncio
import hmac
import json
import logging
from collections import Counter
from collections.abc import Callable, Collection, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Any, Protocol, get_args

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles
from starlette.types import Scope

from formation.monitor.exporters.prometheus import exposition
from formation.monitor.metrics.words import as_json
from formation.monitor.web.connection import OPERATOR
from formation.monitor.web.source import Look, Source
from formation.monitor.web.stream import Streams
from formation.protocol.request import TAKES, Do
from formation.stability.intent import BadOrder

STEERING = ("pause", "play", "seek", "speed")
MAX_BODY_BYTES = 4096
"""Longest body of a request [bytes]."""
MAX_TEXT_CHARS = 64
MAX_MAGNITUDE = 1e12
"""Largest magnitude of a number in a body."""
READ_TIMEOUT_SECONDS = 5.0
"""Longest time for receiving a body [s]."""
MAX_ORDERS, MAX_EXTRA_STOPS = 16, 16
"""Most orders under way, and most stops in addition: stops never wait for other orders."""
MAX_DRIVES = 4
"""Most velocities of drivers under way; they never wait for orders, nor orders for them."""
MAX_STEP_AGE = 2.0
"""Age of the newest step from which on the monitor counts as stuck [s]."""
SITE = Path(str(files("formation.monitor.web").joinpath("site")))
NO_STORE = {"cache-control": "no-store"}
_log = logging.getLogger(__name__)


class Control(Protocol):
    """Carries an operator's orders to the fleet: a `formation.monitor.web.control.Operator`.

    Methods are called in threads of the server, perhaps in several at once.
    """

    @property
    def token(self) -> str:
        """The token required in a request for an order."""

    def order(self, do: str, *, click: str = "", seen: float | None = None, **what: Any) -> dict[str, Any]:
        """Give an order and return the answers, as in `formation order --json`.

        Raises ValueError, for an order with an illegal value BadOrder.
        """

    def drive(self, *, driver: str, forward: float, turn: float, token: int) -> dict[str, Any]:
        """Drive the leader by hand, and return its answer. Raises ValueError."""


Steer = Callable[[str, float | None], dict[str, Any]]
"""Pause, play, seek to a time [s, system clock] or set the speed of a replay; return the new state.

Called in threads of the server. ValueError for an invalid request.
"""


def application(source: Source, streams: Streams, control: Control | None, steer: Steer | None) -> Starlette:
    """Return the application, without the gate in front of it."""
    routes: list[Route | Mount] = [
        Route("/stream", streams, methods=["GET"]),
        Route("/healthz", partial(_health, source)),
        Route("/metrics", partial(_metrics, streams)),
        Route("/api/snapshot", partial(_snapshot, streams)),
    ]
    if control is not None:
        orders = Orders(source, control)
        routes.append(Route("/api/order", orders.order, methods=["POST"]))
        routes.append(Route("/api/order", orders.check_token, methods=["GET"]))
        routes.append(Route("/api/drive", orders.drive, methods=["POST"]))
    if steer is not None:
        routes.append(Route("/api/replay", partial(_steer, steer), methods=["POST"]))
    routes.append(Route("/api/{rest:path}", _not_available, methods=["GET", "POST"]))
    routes.append(Mount("/", Site(directory=SITE, html=True, check_dir=False)))
    return Starlette(routes=routes, exception_handlers={HTTPException: _error_response})


async def _health(source: Source, _request: Request) -> Response:
    """Answer that the server is alive and the monitor makes steps."""
    if (age := source.step_age) > MAX_STEP_AGE:
        raise HTTPException(503, f"the newest step of the monitor is {age:.1f} s old")
    return PlainTextResponse("ok\n", headers=NO_STORE)


async def _not_available(request: Request) -> Response:
    """Answer a request for a function that this server was started without."""
    raise HTTPException(404, f"there is no {request.url.path} here")


async def _metrics(streams: Streams, request: Request) -> Response:
    """Answer with the metrics for Prometheus."""
    look = await _next_frame(streams)
    body, content_type = exposition(look.snapshot, look.frame["recording"], request.headers.get("accept", ""))
    return Response(body, headers={**NO_STORE, "content-type": content_type})


async def _snapshot(streams: Streams, _request: Request) -> Response:
    """Answer with the snapshot for programs."""
    return JSONResponse(as_json((await _next_frame(streams)).snapshot), headers=NO_STORE)


async def _next_frame(streams: Streams) -> Look:
    look = await streams.next_frame()
    if look is None:
        raise HTTPException(503, "there are no metrics at the moment")
    return look


class Orders:
    """The operator's orders, accepted with the token."""

    def __init__(self, source: Source, control: Control) -> None:
        self._source, self._control = source, control
        self._orders = ThreadPoolExecutor(MAX_ORDERS + MAX_EXTRA_STOPS, "order")
        self._drives = ThreadPoolExecutor(MAX_DRIVES, "drive")
        self._under_way: Counter[ThreadPoolExecutor] = Counter()

    async def check_token(self, request: Request) -> Response:
        """Answer whether the sender may give orders, so that a missing token shows before the first stop."""
        self._require_token(request)
        return Response(status_code=204, headers=NO_STORE)

    async def order(self, request: Request) -> Response:
        """Give an order and answer with the robots' answers."""
        self._require_token(request)
        body = await _body(request)
        do = _one_of(body, "do", [one for one in get_args(Do) if one != "drive"])
        what = {name: body.get(name) for name in TAKES.get(do, ())}
        if do == "shape":
            what["shape"] = _one_of(body, "shape", self._source.shapes)
        order = partial(
            self._control.order, do, click=_text(body, "click"), seen=_number(body, "seen"), **what
        )
        return await self._run(self._orders, MAX_ORDERS + MAX_EXTRA_STOPS * (do == "stop"), order)

    async def drive(self, request: Request) -> Response:
        """Pass on a driver's velocity and answer with the leader's answer."""
        self._require_token(request)
        body = await _body(request)
        share = {name: _number(body, name) or 0.0 for name in ("forward", "turn")}
        token = int(_number(body, "token") or 0.0)
        drive = partial(self._control.drive, driver=_text(body, "driver"), token=token, **share)
        return await self._run(self._drives, MAX_DRIVES, drive)

    def _require_token(self, request: Request) -> None:
        """Refuse a request without the token."""
        given, right = request.headers.get("authorization", ""), f"Bearer {self._control.token}"
        if not hmac.compare_digest(given.encode(), right.encode()):
            raise HTTPException(401, "orders need the page's token", {"www-authenticate": "Bearer"})
        request.scope[OPERATOR] = True

    async def _run(
        self, threads: ThreadPoolExecutor, limit: int, order: Callable[[], dict[str, Any]]
    ) -> Response:
        """Give an order, or a velocity, in one of `threads`, and answer with what it returns.

        It is refused while `limit` are under way.
        """
        if self._under_way[threads] >= limit:
            raise HTTPException(
                429, f"{limit} are under way, the most at once; try again", {"retry-after": "1"}
            )
        self._under_way[threads] += 1
        try:
            answer = await asyncio.get_running_loop().run_in_executor(threads, order)
            return JSONResponse(answer, headers=NO_STORE)
        except BadOrder as error:
            raise HTTPException(400, str(error)) from None
        except ValueError as error:
            raise HTTPException(409, str(error)) from None
        except Exception as error:  # noqa: BLE001 - the page has to show any failure
            _log.exception("an order of the page was not given")
            raise HTTPException(500, f"the order was not given: {error}") from None
        finally:
            self._under_way[threads] -= 1


async def _steer(steer: Steer, request: Request) -> Response:
    """Steer a replay and answer with its state. It moves no robot, so it needs no token."""
    body = await _body(request)
    do, to = _one_of(body, "do", STEERING), _number(body, "to")
    if to is None and do in {"seek", "speed"}:
        raise HTTPException(400, f"to: {do} needs a number: a time [s], or how many times as fast")
    try:
        state = await asyncio.to_thread(steer, do, to)
    except ValueError as error:
        raise HTTPException(400, str(error)) from None
    return JSONResponse(state, headers=NO_STORE)


class Site(StaticFiles):
    """The page's own files; a browser checks each time whether they have changed."""

    async def get_response(self, path: str, scope: Scope) -> Response:
        """Answer with one file."""
        response = await super().get_response(path, scope)
        response.headers["cache-control"] = "no-cache"
        return response


async def _body(request: Request) -> dict[str, Any]:
    kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if kind != "application/json":  # a form of a foreign page cannot send this
        raise HTTPException(415, "the body must be application/json")
    data = bytearray()
    try:
        async with asyncio.timeout(READ_TIMEOUT_SECONDS):
            async for piece in request.stream():
                data += piece
                if len(data) > MAX_BODY_BYTES:
                    raise HTTPException(413, f"the body must be at most {MAX_BODY_BYTES} bytes")
    except TimeoutError:
        raise HTTPException(408, f"the body did not arrive within {READ_TIMEOUT_SECONDS:g} s") from None
    except ClientDisconnect:
        raise HTTPException(400, "the body was cut off") from None
    try:
        body = json.loads(data)
    except (ValueError, RecursionError):
        body = None
    if not isinstance(body, dict):
        raise HTTPException(400, "the body must be a JSON object")
    return body


def _one_of(body: Mapping[str, Any], key: str, legal: Collection[str]) -> str:
    value = body.get(key)
    if not isinstance(value, str) or value not in legal:
        raise HTTPException(400, f"{key}: must be one of {', '.join(legal)}")
    return value


def _number(body: Mapping[str, Any], key: str) -> float | None:
    value = body.get(key)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) <= MAX_MAGNITUDE:
        raise HTTPException(400, f"{key}: must be a number")
    return float(value)


def _text(body: Mapping[str, Any], key: str) -> str:
    value = body.get(key, "")
    if not isinstance(value, str) or len(value) > MAX_TEXT_CHARS:
        raise HTTPException(400, f"{key}: must be text of at most {MAX_TEXT_CHARS} letters")
    return value


async def _error_response(_request: Request, error: Exception) -> Response:
    if not isinstance(error, HTTPException):  # as starlette would have it typed
        raise error
    return JSONResponse(
        {"error": error.detail}, error.status_code, headers={**NO_STORE, **(error.headers or {})}
    )
