"""docs/safety.json and docs/safety.md: the bars, and every part with when, how long and at which commit."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from tests.campaigns.bench.figures import markdown, rounded, verdict
from tests.campaigns.reliability.document import DOCS
from tests.campaigns.safety.part import Found, Part

JSON, TEXT = "safety.json", "safety.md"
HEAD = """\
# Safe among each other

Written, with [the same figures for programs](safety.json), by

```sh
python3 deploy/env.py python -m tests.campaigns.safety
```

What keeps bodies apart: the collision filter, range scans, a world with contacts; and what changes while
robots drive. Every figure was run, at the commit that its section names.
"""


def write(found: Mapping[str, Found], parts: Mapping[str, Part], folder: Path = DOCS) -> None:
    """Put `found` in place of what these parts had found before, and write both files anew."""
    path = folder / JSON
    before = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    every = {**before, **rounded(dict(found))}
    ordered = {name: every[name] for name in parts if name in every}
    path.write_text(json.dumps(ordered, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    (folder / TEXT).write_text(text(ordered, parts), encoding="utf-8")


def text(found: Mapping[str, Found], parts: Mapping[str, Part], head: str = HEAD) -> str:
    """What people read: all bars first, then part by part."""
    bars = [
        (
            f"[{parts[name].TITLE}](#{_anchor(parts[name].TITLE)})",
            one["bar"],
            one["found"],
            verdict(one["held"]),
        )
        for name, part in found.items()
        for one in part["bars"]
    ]
    return "\n".join(
        [
            head,
            markdown(("", "asked for", "found", ""), bars),
            *(section(name, parts[name], one) for name, one in found.items()),
        ]
    )


def section(name: str, part: Part, found: Found) -> str:
    """One part."""
    where = f"{found['date']}, commit {found['commit']}, {found['machine']}; {found['took'] / 60.0:.0f} min"
    command = f"python3 deploy/env.py python -m tests.campaigns.safety {name}"
    return f"## {part.TITLE}\n\n```sh\n{command}\n```\n\n{where}.\n\n{part.ABOUT}\n\n{part.section(found)}"


def _anchor(title: str) -> str:
    return title.lower().replace(" ", "-").replace(",", "")
