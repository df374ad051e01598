"""`formation deploy rollback`: return all robots to their previous release."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from formation.deploy.arguments import parser, tell
from formation.deploy.fleet import fleet as fleets
from formation.deploy.fleet.fleet import Fleet
from formation.deploy.fleet.remote import RemoteError

EXAMPLES = """\
  formation deploy rollback field
  formation deploy rollback field --only robot2 --user ubuntu

It goes one release back, and not further. The way forward again is a push.
Exit code 0: all robots have gone back; 1: some have not, for the reasons named.
"""


def main(arguments: Sequence[str]) -> int:
    """Roll back; return the exit code."""
    options = parser("deploy rollback", "Go back to the release before the last.", EXAMPLES)
    fleets.add_flags(options)
    fleets.add_no_restart(options)
    options.add_argument(
        "--no-systemd", action="store_true", help="only links, no units; then sudo is not used"
    )
    chosen = options.parse_args(arguments)
    fleet = fleets.read(chosen, sudo=not chosen.no_systemd)
    restart = not (chosen.no_restart or chosen.no_systemd)
    results = fleets.on_all(
        fleet,
        lambda robot: fleet.ssh.call(robot, "rollback", {"restart": restart, "units": not chosen.no_systemd}),
    )
    tell(chosen, "\n".join(words(fleet, results)), lambda: report(results))
    return 0 if all(map(_well, results.values())) else 1


def words(fleet: Fleet, results: Mapping[str, dict[str, Any] | RemoteError]) -> list[str]:
    """Return the results for people."""
    width = max(map(len, fleet.robots)) + 2
    lines = []
    for name, result in results.items():
        if isinstance(result, RemoteError):
            lines.append(f"  {name:<{width}}FAILED  {result}")
            lines += [f"  {'':<{width}}  | {text}" for text in result.lines]
        else:
            lines.append(f"  {name:<{width}}{result['left']} -> {result['release']}")
            if result["restart"]:
                lines.append(f"  {'':<{width}}  but its units did not start: {result['restart']}")
    failed = [name for name, result in results.items() if not _well(result)]
    well = len(results) - len(failed)
    return [*lines, f"{well} of {len(results)} robots" + (f"; FAILED: {', '.join(failed)}" if failed else "")]


def report(results: Mapping[str, dict[str, Any] | RemoteError]) -> dict[str, Any]:
    """Return the results for a script."""
    robots = {
        name: {"ok": False, "reason": str(result)}
        if isinstance(result, RemoteError)
        else {"ok": _well(result), **result}
        for name, result in results.items()
    }
    return {"ok": all(map(_well, results.values())), "robots": robots}


def _well(result: dict[str, Any] | RemoteError) -> bool:
    return not isinstance(result, RemoteError) and not result["restart"]
