"""`formation missions`: what is on the shelf."""

from __future__ import annotations

from collections.abc import Sequence

from deploy.arguments import as_json, parser, read_mission
from formation.mission_file import shipped


def main(arguments: Sequence[str]) -> int:
    """List the shipped missions; the exit code."""
    options = parser(
        "missions",
        "List the missions that are shipped: copy one, change it, name the file; or `formation new`.",
    )
    options.add_argument("--json", action="store_true", help="one JSON object on the last line")
    chosen = options.parse_args(arguments)
    rows = {name: (read_mission(name), str(path)) for name, path in shipped().items()}
    if chosen.json:
        listing = {
            name: {"robots": len(mission.robots), "law": mission.law.kind, "file": path}
            for name, (mission, path) in rows.items()
        }
        print(as_json({"missions": listing}))
        return 0
    for name, (mission, path) in rows.items():
        followers = f"{len(mission.followers):>3} followers behind {mission.leader}"
        print(f"{name:<18}{followers:<26} {mission.law.kind} law  {path}")
    return 0
