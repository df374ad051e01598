"""`formation deploy status`: which robots run which release and mission, since when, and their units."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from typing import Any, NamedTuple

from deploy.arguments import as_json, parser
from deploy.field import fleet as fleets
from deploy.field.fleet import Bundle, Fleet
from deploy.field.remote import RemoteError

EXAMPLES = """\
  formation deploy status field --user ubuntu
  formation deploy status field --json

Exit code 0: every robot runs what is in DIR; 1: some do not, as named.
"""


TITLES = ("release", "formation", "mission", "since")


class State(NamedTuple):
    """How one robot is, and what of it is not as in its bundle."""

    said: Mapping[str, Any]
    differs: tuple[str, ...]
    """Sentences; none if all is as it should be."""
    units: Mapping[str, Mapping[str, Any]]
    """What systemd says of each; none where they do not matter."""


def main(arguments: Sequence[str]) -> int:
    """Ask all robots; the exit code."""
    options = parser("deploy status", "Which robots run which version and mission, since when.", EXAMPLES)
    fleets.add_flags(options)
    options.add_argument(
        "--no-systemd", action="store_true", help="they were installed without units; then sudo is not used"
    )
    chosen = options.parse_args(arguments)
    fleet = fleets.read(chosen, sudo=not chosen.no_systemd)
    answers = fleets.everybody(fleet, lambda robot: fleet.ssh.call(robot, "status", {}))
    states = {
        name: state(fleet.bundles[name], answer, units=not chosen.no_systemd)
        for name, answer in answers.items()
    }
    for text in words(fleet, states):
        print(text)
    if chosen.json:
        print(as_json(report(fleet, states)))
    return 1 if any(one.differs for one in states.values()) else 0


def state(bundle: Bundle, answer: Mapping[str, Any] | RemoteError, *, units: bool = True) -> State:
    """Compare what a robot says with its bundle."""
    if isinstance(answer, RemoteError):
        return State({}, (str(answer),), {})
    if answer["release"] is None:
        return State(answer, ("nothing is installed",), {})
    return State(answer, tuple(_differences(bundle, answer, units=units)), answer["units"] if units else {})


def words(fleet: Fleet, states: Mapping[str, State]) -> list[str]:
    """The states for people."""
    rows = {name: _row(fleet.bundles[name], one) for name, one in states.items()}
    widths = [max(len(row[column]) for row in (TITLES, *rows.values())) for column in range(len(TITLES))]
    width = max(len("robot"), *map(len, states))

    def line(name: str, cells: Sequence[str]) -> str:
        padded = (f"{cell:<{size}}" for cell, size in zip(cells, widths, strict=True))
        return f"  {name:<{width}}  {'  '.join(padded)}".rstrip()

    lines = [line("robot", TITLES)]
    for name, one in states.items():
        lines.append(line(name, rows[name]))
        lines += [f"  {'':<{width}}  {_unit(*unit)}" for unit in one.units.items()]
        lines += [f"  {'':<{width}}  ! {text}" for text in one.differs]
    other = [name for name, one in states.items() if one.differs]
    well = len(states) - len(other)
    return [
        *lines,
        f"{well} of {len(states)} as in the bundles" + (f"; not {', '.join(other)}" if other else ""),
    ]


def report(fleet: Fleet, states: Mapping[str, State]) -> dict[str, Any]:
    """The states for a script."""
    robots = {
        name: {
            "ok": not one.differs,
            "address": fleet.robots[name].address,
            "bundle": fleet.bundles[name].release,
            "differs": list(one.differs),
            **one.said,
        }
        for name, one in states.items()
    }
    return {"ok": not any(one.differs for one in states.values()), "robots": robots}


def since(then: float, now: float) -> str:
    """A moment, and how long ago it was by the robot's own clock [s]."""
    ago = max(now - then, 0.0)
    scale, unit = next(
        (pair for pair in ((86_400, "d"), (3_600, "h"), (60, "min")) if ago >= pair[0]), (1, "s")
    )
    return f"{datetime.fromtimestamp(then, UTC):%m-%d %H:%M} UTC ({ago / scale:.0f} {unit})"


def _differences(bundle: Bundle, said: Mapping[str, Any], *, units: bool) -> Iterator[str]:
    if said["release"] != bundle.release:
        yield f"release differs: {bundle.release} is in the bundle; push it"
    if said["mission_sha256"] is None:
        yield "its mission file is gone: push with --reinstall"
    elif said["mission_sha256"] != bundle.mission_sha256:
        yield "mission differs from the bundle's: push it"
    if units and not said["units"]:
        yield "it has no units: was it installed with --no-systemd?"
    for unit, facts in said["units"].items() if units else ():
        if facts["active"] != "active":
            yield f"{unit} is {facts['active']}: see journalctl -u {unit} there"


def _row(bundle: Bundle, one: State) -> tuple[str, ...]:
    said, version = one.said, one.said.get("version", {})
    if said.get("release") is None:
        return ("-",) * len(TITLES)
    same = said["mission_sha256"] == bundle.mission_sha256
    mission = f"{version.get('mission', '-')}{'' if same else ' (differs)'}"
    return (
        str(said["release"]),
        str(version.get("formation", "-")),
        mission,
        since(said["since"], said["now"]),
    )


def _unit(name: str, facts: Mapping[str, Any]) -> str:
    restarts = f", {facts['restarts']} restarts" if facts["restarts"] else ""
    says = f"  {facts['says']}" if facts["says"] else ""
    return f"{name}: {facts['active']}{restarts}{says}"
