"""All defects, by name, from the files of this folder.

A paragraph begins with the file of the product that its defects change. A defect has a line with its name,
the groups of plans that it meets first, and what it breaks; then, behind -, text that the file contains
exactly once, and behind + what replaces it. Lines without a replacement are removed.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from tests.campaigns.defects.defect import Defect

DEFECT = re.compile(r"^([\w-]+) \((.+)\): (.+)\n((?:- .*\n)+)((?:\+ .*\n)*)", re.MULTILINE)


def read(path: Path) -> Iterator[Defect]:
    """All defects of one file."""
    _, *paragraphs = path.read_text(encoding="utf-8").strip().split("\n\n")
    for paragraph in paragraphs:
        file, _, rest = f"{paragraph}\n".partition("\n")
        assert not DEFECT.sub("", rest), f"{path}: {DEFECT.sub('', rest)}"
        for name, first, breaks, *texts in DEFECT.findall(rest):
            before, after = ("\n".join(line[2:] for line in text.splitlines()) for text in texts)
            whole = before if after else f"{before}\n"
            yield Defect(name, file, whole, after, breaks, tuple(first.split()))


EVERY = [
    defect
    for name in (
        *("safety", "orders", "persistence", "collisions", "control"),
        *("sensing", "election", "leading", "watching"),
    )
    for defect in read(Path(__file__).with_name(f"{name}.txt"))
]
DEFECTS: Mapping[str, Defect] = {one.name: one for one in EVERY}
