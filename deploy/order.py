"""`formation order`: an operator's word to the robots of a running mission, acknowledged one by one."""

from __future__ import annotations

import argparse
import secrets
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from deploy.arguments import as_json, number, parser, read_mission
from deploy.doctor import files
from deploy.refusal import Refusal
from deploy.waiting import waiting
from formation import order
from formation.mission import Mission
from formation.order import OperatorReply, OperatorRequest
from formation.topics import ORDER
from formation.transport import wiring
from formation.transport.bus import Bus, Reply
from formation.transport.bus_config import MODES, BusConfig, BusError, parse_override
from formation.transport.wiring import Links
from formation.wire import BadMessage

EVERYONE = ("stop", "release")
"""Told to each robot directly; hold and run are the leader's, whose order travels with the positions."""
ROUND = 0.5
"""How long one question waits for all its answers before it is put again [s]."""
OPERATOR = "operator"
EXAMPLES = """\
  formation order six_robots stop            every robot, at once; it stays stopped until released
  formation order six_robots release
  formation order six_robots hold            the leader, whose order travels with the positions
  formation order my_mission.toml stop -e tcp/192.168.1.11:7460 -e tcp/192.168.1.12:7460
  formation order my_mission.toml stop -c operator/zenoh.json5      with the operator's certificate

Exit code 0: everyone asked has obeyed; 1: somebody did not answer, or refused.
"""
Ask = Callable[[str, bytes, float], Sequence[Reply]]
"""`formation.transport.bus.Bus.ask`."""


class Answer(NamedTuple):
    """One robot's answer."""

    reply: OperatorReply
    ms: float
    """Round trip [ms]."""


def main(arguments: Sequence[str]) -> int:
    """Give an order; the exit code."""
    options = _options().parse_args(arguments)
    mission = read_mission(options.mission)
    asked = mission.names if options.do in EVERYONE else (mission.leader,)
    try:
        with (
            waiting(f"asking for up to {options.timeout:g} s"),
            Bus(_config(options, mission, asked)) as bus,
        ):
            answers = ask(
                bus.ask, asked, OperatorRequest(do=options.do, id=secrets.token_hex(8)), options.timeout
            )
    except BusError as error:
        raise Refusal(str(error)) from None
    obeyed = all(name in answers and answers[name].reply.ok for name in asked)
    print(words(options.do, asked, answers, options.timeout))
    ends = options.connect or wiring.endpoints(mission).agents.values()
    if len(answers) < len(asked) and options.config is None and wiring.under_certificates(ends):
        print("robots under certificates answer an operator who has one: -c FILE names his configuration")
    if len(answers) < len(asked) and (whose := _not_the_operators(options.config)):
        print(f"orders are taken from the operator, and {options.config} has the certificate of {whose!r}")
    if options.json:
        print(as_json(report(options.do, asked, answers)))
    return 0 if obeyed else 1


def ask(
    put: Ask, robots: Sequence[str], request: OperatorRequest, seconds: float, pause: float = 0.02
) -> dict[str, Answer]:
    """Ask `robots` until each has answered, for at most `seconds`; the answers there are, by robot.

    A question reaches who is linked at that moment, and links take a moment, so it is put again and again:
    by its id it is known as the same.
    """
    key = ORDER.key(robots[0]) if len(robots) == 1 else ORDER.pattern.format(robot="*")
    payload = order.encode(request)
    answers: dict[str, Answer] = {}
    deadline = time.monotonic() + seconds
    while (left := deadline - time.monotonic()) > 0.0:
        for name, answer in _read(put(key, payload, min(left, ROUND))):
            if name in robots:
                answers.setdefault(name, answer)
        if len(answers) == len(robots):
            break
        time.sleep(pause)
    return answers


def report(do: str, asked: Iterable[str], answers: Mapping[str, Answer]) -> dict[str, Any]:
    """The answers for a script."""
    robots = {
        name: {
            "ok": answer.reply.ok,
            "mode": answer.reply.mode,
            "reason": answer.reply.reason,
            "ms": round(answer.ms, 3),
        }
        for name, answer in answers.items()
    }
    missing = [name for name in asked if name not in answers]
    return {"do": do, "robots": robots, "missing": missing}


def words(do: str, asked: Sequence[str], answers: Mapping[str, Answer], seconds: float) -> str:
    """The answers for people."""
    lines = []
    for name in asked:
        answer = answers.get(name)
        if answer is None:
            text = f"NO ANSWER within {seconds:g} s"
        else:
            verdict = _verdict(do, answer.reply)
            text = f"{verdict:<8}{answer.ms:7.1f} ms  {answer.reply.reason}"
        lines.append(f"  {name:<12}{text}".rstrip())
    obeyed = sum(answer.reply.ok for answer in answers.values())
    missing = [name for name in asked if name not in answers]
    last = f"{do}: {obeyed} of {len(asked)} obey"
    if missing:
        last += f"; no answer from {', '.join(missing)}"
    return "\n".join([*lines, last])


def _verdict(do: str, reply: OperatorReply) -> str:
    if not reply.ok:
        return "REFUSED"
    # a robot that was released stands until it hears the leader, and says so
    return "released" if (do, reply.mode) == ("release", "stop") else reply.mode


def _read(replies: Iterable[Reply]) -> Iterable[tuple[str, Answer]]:
    for reply in replies:
        try:
            said = order.decode(OperatorReply, reply.payload)
        except BadMessage:
            continue  # whoever says that is no robot of ours
        if reply.key == ORDER.key(said.robot):
            yield said.robot, Answer(said, reply.ms)


def _options() -> argparse.ArgumentParser:
    options = parser(
        "order", "Hold, run, stop or release the robots of a running mission; see who obeys.", EXAMPLES
    )
    options.add_argument("mission", metavar="MISSION", help="a TOML file, or the name of a shipped mission")
    options.add_argument(
        "do",
        choices=("hold", "run", "stop", "release"),
        help="hold, run: by way of the leader; stop: each robot at once, until released",
    )
    options.add_argument(
        "--timeout",
        type=number(0.0, 600.0, open_below=True),
        default=3.0,
        metavar="S",
        help="wait so long for answers (default 3)",
    )
    options.add_argument("--json", action="store_true", help="one JSON object as the last line on stdout")
    links = options.add_argument_group(
        "links (without -e and endpoints in FILE those that the mission implies)"
    )
    links.add_argument("-m", "--mode", choices=MODES, help="Zenoh session mode (default: peer)")
    links.add_argument(
        "-e",
        "--connect",
        metavar="ENDPOINT",
        action="append",
        default=[],
        help="endpoint of an agent or the leader to dial; repeatable",
    )
    links.add_argument("-c", "--config", metavar="FILE", type=Path, help="Zenoh configuration file (JSON5)")
    links.add_argument(
        "--cfg",
        metavar="KEY:VALUE",
        action="append",
        default=[],
        help="one Zenoh setting, which outranks all others; repeatable",
    )
    return options


def _not_the_operators(config: Path | None) -> str:
    """Whose certificate `config` names, if it is not the operator's; empty else."""
    papers = None if config is None else files.papers_of(config)
    read = None if papers is None else files.read(OPERATOR, papers)
    return "" if read is None or read.name == OPERATOR else read.name


def _config(options: argparse.Namespace, mission: Mission, asked: Iterable[str]) -> BusConfig:
    where = wiring.endpoints(mission).agents
    implied = Links((), tuple(where[name] for name in asked))
    return BusConfig(
        connect=tuple(options.connect),
        implied=None if options.connect else implied,
        mode=options.mode,
        namespace=mission.team or "",
        config_file=options.config,
        overrides=tuple(parse_override(text) for text in options.cfg),
        name=OPERATOR,
    )
