"""`formation replay`: play a recording to the live page, and onto Zenoh under another prefix."""

from __future__ import annotations

import argparse
import math
import socket
import sys
from collections.abc import Sequence
from contextlib import ExitStack, closing
from functools import partial
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

from formation.deploy.arguments import add_json, as_json, number, parser, text_stream
from formation.deploy.refusal import Refusal, refuse_errors, refuse_os_errors
from formation.deploy.terminal.playing import Keys, ReplayBar, ReplayLines, clock, do_key, line
from formation.deploy.terminal.views import in_a_terminal
from formation.monitor.recording.reader import Recording, UnreadableError, read
from formation.monitor.replay.echo import DEFAULT, Echo, checked
from formation.monitor.replay.player import MAX_SPEED, MIN_SPEED, Film, Player
from formation.monitor.replay.process import Replay
from formation.monitor.web import frames
from formation.monitor.web.address import Bind, add_page_flags
from formation.monitor.web.server import PageServer, page_server, words
from formation.monitor.web.source import Source
from formation.transport.bus import Bus
from formation.transport.bus_config import BusConfig, BusError, parse_override
from formation.transport.linger import Linger
from formation.transport.runtime.flags import add_zenoh
from formation.transport.runtime.process import Stop, clocks
from formation.transport.runtime.rate import Rate
from formation.transport.wiring import AGENT_PORT

REFRESH_RATE = 5.0
"""Refresh rate [Hz]."""
HOST, LISTEN_PORT = "127.0.0.1", AGENT_PORT - 1
"""Default address to dial for the messages."""
GIVEN_UP = ("transport/link/tx/queue/congestion_control/block/wait_before_close", "1000000")
"""Time after which the link of a listener that takes nothing is closed [us]."""
EXAMPLES = """\
  formation replay recordings/monday.mcap
  formation replay monday.mcap --speed 10 --start 60
  formation replay monday.mcap --paused --page 0.0.0.0:8460
  formation replay monday.mcap --no-page -l tcp/127.0.0.1:7500    every message on replay/<its key>

In a terminal: space pauses, arrow keys jump 5 s, + and - change the speed, q ends it. It stays at the end for
as long as there is a page to look at. Exit code 0: it was played, or ended with q; 2: nothing was played.
"""


class Opened(NamedTuple):
    """A playable recording, and the stretch to play."""

    recording: Recording
    film: Film
    begin: float
    """Start [s, the recorder's system clock]."""
    until: float
    """End [s, the recorder's system clock]."""


def main(arguments: Sequence[str]) -> int:
    """Play a recording, or verify it; return the exit code."""
    if "--verify" in arguments:
        # imported only here, as it imports the agents, which playing does not need
        code: int = import_module("formation.deploy.recordings.verify").main(arguments)
        return code
    options = _options().parse_args(arguments)
    one = _open(options)
    prefix = None if options.no_zenoh else _prefix(options, one)
    with ExitStack() as stack:
        stop = stack.enter_context(Stop())
        bus = None if prefix is None else stack.enter_context(_session(options))
        echo = None
        if bus is not None and prefix is not None:
            echo = Echo(one.recording.mission, prefix, partial(bus.advertise, waits=True), bus.publish)
        player = Player(
            one.film, clocks().mono, speed=options.speed, paused=options.paused, stretch=one.film.stretch,
            until=one.until,
        )  # fmt: skip
        if one.begin > one.film.start:
            player.seek(one.begin)
        source = None if options.no_page else _source(one, player)
        replay = Replay(one.recording.mission, player, source, echo, one.begin if options.loop else None)
        if source is not None:
            page = stack.enter_context(_page(options, source, replay))
            _say(options, f"page: {words(options.page, page)}")
        if prefix is not None:
            ends = [f"listens at {end}" for end in options.listen]
            ends += [f"dials {end}" for end in options.connect]
            where = f"; {', '.join(ends)}" if ends else ""  # a configuration file may name others
            _say(options, f"every message on {prefix}/…{where}")
        _play(options, replay, stop, stack)
    if options.json:
        print(as_json(_report(one, prefix, replay, stop)), flush=True)
    return 130 if stop.reason == "SIGINT" else 0


def _play(options: argparse.Namespace, replay: Replay, stop: Stop, stack: ExitStack) -> None:
    """Play until the end, or until told to stop."""
    keys = stack.enter_context(Keys())
    drawn = in_a_terminal(sys.stdout) and not options.json
    view = ReplayBar(sys.stdout) if drawn else ReplayLines(text_stream(options))
    stays = drawn and not options.no_page
    refresh, linger = Rate(REFRESH_RATE), Linger()
    try:
        with view:
            while not stop:
                pause = replay.turn()
                mono = clocks().mono
                linger.tend(mono)
                ended = replay.state.finished and not stays
                if refresh.tick(mono) or ended:
                    view.show(replay.state, lambda: replay.snapshot)
                if ended or not all(do_key(replay, key) for key in keys.wait(pause)):
                    return
    finally:
        if not drawn:
            _say(options, line(replay.state, replay.snapshot))


def _open(options: argparse.Namespace) -> Opened:
    """Return the recording. Raises Refusal if it is none, or does not have the requested stretch."""
    with refuse_errors(UnreadableError):
        recording = read(options.file)
        film = Film(recording)
    length = film.end - film.start
    if options.start > length:
        raise Refusal(f"--start {options.start:g}: the recording is over after {length:.1f} s")
    if options.until <= options.start:
        raise Refusal(f"--until {options.until:g}: must be later than --start {options.start:g}")
    if incomplete := recording.condition().words:
        _say(options, f"{options.file} is {incomplete}: what can be read is played, {clock(length)}")
    return Opened(recording, film, film.start + options.start, film.start + options.until)


def _prefix(options: argparse.Namespace, one: Opened) -> str:
    try:
        return checked(options.prefix, one.recording.mission)
    except ValueError as error:
        raise Refusal(f"--prefix {error}") from None


def _source(one: Opened, player: Player) -> Source:
    about = frames.hello(one.recording.mission, live=False, control=False, version=version("zenoh-formation"))
    return Source({**about, "recording": str(one.recording.path)}, lambda: player.goal)


def _page(options: argparse.Namespace, source: Source, replay: Replay) -> PageServer:
    with refuse_os_errors(f"--page {options.page or Bind()}"):
        return page_server(options.page, source, steer=replay.steer)


def _session(options: argparse.Namespace) -> Bus:
    """Return a session that only processes that dial it receive, by default. Raises Refusal."""
    if not (options.listen or options.connect or options.mode == "client" or options.config):
        options.listen = [f"tcp/{HOST}:{_free_port()}"]
    with refuse_errors(BusError):
        return Bus(
            BusConfig(
                listen=tuple(options.listen),
                connect=tuple(options.connect),
                mode=options.mode,
                config_file=options.config,
                overrides=(GIVEN_UP, *(parse_override(text) for text in options.cfg)),
                name="replay",
            )
        )


def _free_port() -> int:
    """Return the usual port, or another one if that is taken."""
    for port in (LISTEN_PORT, 0):
        with closing(socket.socket()) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((HOST, port))
            except OSError:
                continue
            return int(probe.getsockname()[1])
    raise Refusal(f"there is no free port at {HOST} for the messages: name one with -l, or say --no-zenoh")


def _report(one: Opened, prefix: str | None, replay: Replay, stop: Stop) -> dict[str, Any]:
    state, snapshot = replay.state, replay.snapshot
    return {
        "recording": str(one.recording.path),
        "mission": one.recording.mission.name,
        "length": one.film.end - one.film.start,
        "position": state.position - state.start,
        "finished": state.finished,
        "interrupted": bool(stop),
        "played": state.played,
        "prefix": prefix,
        "published": state.published,
        "skipped": state.skipped,
        "drift": state.drift,
        "formation_error": snapshot.final_error,
        "known": snapshot.known_verdict.as_json(),
        "settling_time": snapshot.settling_time,
        "converged": snapshot.converged,
    }


def _say(options: argparse.Namespace, text: str) -> None:
    print(text, file=text_stream(options), flush=True)


def _options() -> argparse.ArgumentParser:
    options = parser(
        "replay",
        "Play a recording: to the live page, and onto Zenoh keys that no robot listens to.",
        EXAMPLES,
    )
    options.add_argument(
        "file",
        metavar="FILE",
        type=Path,
        help="the recording, MCAP; one that is cut off or damaged plays as well",
    )
    options.add_argument(
        "--speed", type=number(MIN_SPEED, MAX_SPEED), default=1.0, metavar="X",
        help=f"{MIN_SPEED:g} to {MAX_SPEED:g} (default 1)",
    )  # fmt: skip
    options.add_argument(
        "--start",
        type=number(0.0, unit="s"),
        default=0.0,
        metavar="S",
        help="where to begin, from the recording's start [s]",
    )
    options.add_argument(
        "--until",
        type=number(0.0, unit="s"),
        default=math.inf,
        metavar="S",
        help="where to end, from the recording's start [s]",
    )
    options.add_argument("--paused", action="store_true", help="wait at the beginning until played")
    options.add_argument("--loop", action="store_true", help="begin again at the end, for ever")
    options.add_argument(
        "--verify", action="store_true",
        help="play nothing: would today's agents have commanded the same? `--verify --help` says more",
    )  # fmt: skip
    add_json(options)
    add_page_flags(options, control=False)
    links = options.add_argument_group(
        "the messages on Zenoh, each as recorded, with its attachment",
        f"By default a process that dials tcp/{HOST}:{LISTEN_PORT} receives them; if taken, another port"
        " is used, and printed.",
    )
    links.add_argument("--no-zenoh", action="store_true", help="publish nothing there")
    links.add_argument(
        "--prefix", default=DEFAULT, metavar="WORD",
        help=f"what keys begin with (default {DEFAULT}); no word that live keys begin with",
    )  # fmt: skip
    add_zenoh(links, connect="dial that; repeatable", listen="accept links there; repeatable")
    return options
