"""`formation deploy status`: show robots' releases and missions, since when, and their units."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from typing import Any, NamedTuple

from formation.deploy.arguments import parser, print_result
from formation.deploy.fleet import fleet as fleets
from formation.deploy.fleet.fleet import Bundle, Fleet
from formation.deploy.fleet.remote import RemoteError, Robot
from formation.deploy.terminal.bar import message_if_slow

EXAMPLES = """\
  formation deploy status field --user ubuntu
  formation deploy status field --json

Exit code 0: every robot runs what is in DIR; 1: some do not, as named.
"""
TITLES = ("release", "formation", "mission", "since")


class InstalledState(NamedTuple):
    """The state of one robot, and its differences from its bundle."""

    reply: Mapping[str, Any]
    differs: tuple[str, ...]
    """Differences as sentences; empty if there are none."""
    units: Mapping[str, Mapping[str, Any]]
    """State of each unit by systemd; empty if they do not matter."""
    warning: str = ""
    """What will soon be wrong."""


def main(arguments: Sequence[str]) -> int:
    """Ask all robots; return the exit code."""
    options = parser("deploy status", "Which robots run which version and mission, since when.", EXAMPLES)
    fleets.add_flags(options)
    options.add_argument(
        "--no-systemd", action="store_true", help="they were installed without units; then sudo is not used"
    )
    chosen = options.parse_args(arguments)
    fleet = fleets.read(chosen, sudo=not chosen.no_systemd)

    def query(robot: Robot) -> InstalledState:
        answer = fleet.ssh.call(robot, "status", {})
        return state(fleet.bundles[robot.name], answer, robot.prefix, units=not chosen.no_systemd)

    with message_if_slow(f"asking {', '.join(fleet.robots)}"):
        answers = fleets.on_all(fleet, query)
    states = {
        name: InstalledState({}, (str(one),), {}) if isinstance(one, RemoteError) else one
        for name, one in answers.items()
    }
    print_result(chosen, "\n".join(words(fleet, states)), lambda: report(fleet, states))
    return 1 if any(one.differs for one in states.values()) else 0


def state(bundle: Bundle, answer: Mapping[str, Any], prefix: str, *, units: bool = True) -> InstalledState:
    """Compare a robot's answer with its bundle, installed under `prefix`."""
    if answer["release"] is None:
        return InstalledState(answer, ("nothing is installed",), {})
    return InstalledState(
        answer,
        tuple(_differences(bundle, answer, prefix, units=units)),
        answer["units"] if units else {},
        fleets.expiry(answer["version"], answer["now"]),
    )


def words(fleet: Fleet, states: Mapping[str, InstalledState]) -> list[str]:
    """Return the states for people."""
    rows = {name: _row(fleet.bundles[name], one) for name, one in states.items()}
    widths = [max(len(row[column]) for row in (TITLES, *rows.values())) for column in range(len(TITLES))]
    width = max(len("robot"), *map(len, states))

    def line(name: str, cells: Sequence[str]) -> str:
        padded = (f"{cell:<{size}}" for cell, size in zip(cells, widths, strict=True))
        return f"  {name:<{width}}  {'  '.join(padded)}".rstrip()

    lines = [line("robot", TITLES)]
    for name, one in states.items():
        lines.append(line(name, rows[name]))
        for unit, facts in one.units.items():
            restarts = f", {facts['restarts']} restarts" if facts["restarts"] else ""
            says = f"  {facts['says']}" if facts["says"] else ""
            lines.append(f"  {'':<{width}}  {unit}: {facts['active']}{restarts}{says}")
        warnings = [one.warning] if one.warning else []
        lines += [f"  {'':<{width}}  ! {text}" for text in (*one.differs, *warnings)]
    other = [name for name, one in states.items() if one.differs]
    well = len(states) - len(other)
    return [
        *lines,
        f"{well} of {len(states)} as in the bundles" + (f"; not {', '.join(other)}" if other else ""),
    ]


def report(fleet: Fleet, states: Mapping[str, InstalledState]) -> dict[str, Any]:
    """Return the states for a script."""
    robots = {
        name: {
            "ok": not one.differs,
            "address": fleet.robots[name].address,
            "bundle": fleet.bundles[name].release,
            "differs": list(one.differs),
            "warning": one.warning,
            **one.reply,
        }
        for name, one in states.items()
    }
    return {"ok": not any(one.differs for one in states.values()), "robots": robots}


def since(then: float, now: float) -> str:
    """Return a moment, and how long ago it was by the robot's own clock, in words; arguments in s."""
    ago = max(now - then, 0.0)
    scale, unit = next(
        (pair for pair in ((86_400, "d"), (3_600, "h"), (60, "min")) if ago >= pair[0]), (1, "s")
    )
    return f"{datetime.fromtimestamp(then, UTC):%m-%d %H:%M} UTC ({ago / scale:.0f} {unit})"


def _differences(bundle: Bundle, reply: Mapping[str, Any], prefix: str, *, units: bool) -> Iterator[str]:
    yield from _of_identity(bundle, reply)
    if reply["release"] != bundle.release:
        yield f"release differs: {bundle.release} is in the bundle; push it"
    if reply["mission_sha256"] is None:
        yield "its mission file is gone: push it"
    elif reply["mission_sha256"] != bundle.mission_sha256:
        yield "mission differs from the bundle's: push it"
    if reply["release"] == bundle.release:
        for name in bundle.differing(prefix, reply["configuration"]):
            if name != "mission.toml":
                yield f"{name} was changed on the robot: push restores it"
    if units:
        yield from _of_units(reply)


def _of_identity(bundle: Bundle, reply: Mapping[str, Any]) -> Iterator[str]:
    version = reply["version"]
    if version.get("robot", bundle.robot) != bundle.robot:
        yield f"this machine is {version['robot']}: is the address right?"
    until = version.get("certificate_until")
    if until is not None and datetime.fromisoformat(until).timestamp() <= reply["now"]:
        yield f"by its clock its certificate has expired on {until}: {fleets.RENEW}"


def _of_units(reply: Mapping[str, Any]) -> Iterator[str]:
    if not reply["units"]:
        yield "it has no units: was it installed with --no-systemd?"
    for unit, facts in reply["units"].items():
        if facts["active"] != "active":
            yield f"{unit} is {facts['active']}: see journalctl -u {unit} there"
        for release in facts["runs"]:
            if release != reply["release"]:
                yield f"{unit} still runs release {release}: systemctl restart {unit} there"


def _row(bundle: Bundle, one: InstalledState) -> tuple[str, ...]:
    reply, version = one.reply, one.reply.get("version", {})
    if reply.get("release") is None:
        return ("-",) * len(TITLES)
    same = reply["mission_sha256"] == bundle.mission_sha256
    mission = f"{version.get('mission', '-')}{'' if same else ' (differs)'}"
    return (
        str(reply["release"]),
        str(version.get("formation", "-")),
        mission,
        since(reply["since"], reply["now"]),
    )
