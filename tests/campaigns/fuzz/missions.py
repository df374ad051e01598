"""Damaged mission files, given to `formation check` in this process."""

from __future__ import annotations

import random
import re
from collections.abc import Iterator
from pathlib import Path

from formation.deploy import check
from formation.deploy.refusal import Refusal
from formation.mission.file import shipped
from tests.campaigns.fuzz.trying import Tried, attempt, damaged, quiet

VALUES = (
    "0", "-1", "1", "true", '""', '"x"', "[]", "{}", "nan", "inf", "-inf", "1e-300", "5e-324",
    "1e308", "-1e308", "1e5", "1e9", "-0.0", "0.2", "200.0", "1000.0", "9" * 5000,
    "0x" + "f" * 5000, "1" * 400 + ".0", '"\\u0000"', '"\\ud800"', "1979-05-27T07:32:00Z",
    "[" * 200 + "]" * 200, "[" * 5000, "[1.0, 2.0]", "[1e308, -1e308]", '["robot2"]', '"all"',
    '"robot1"', "1e-9", "0.001", "1e4", "86400.0", "3600.0",
)  # fmt: skip
_NUMBER = re.compile(r"(?<= )-?\d+(\.\d+)?(e-?\d+)?")


def form(text: str, chance: random.Random) -> bytes:
    """A mission text, damaged: other values, other lines, other bytes."""
    lines = text.splitlines()
    match chance.randrange(10):
        case 6 | 7 | 8 | 9:
            for _ in range(chance.choice((1, 2, 3, 8))):
                _scaled(lines, chance)
        case 0:
            return damaged(text.encode(), chance)
        case 1 | 2 | 3:
            for _ in range(chance.choice((1, 1, 1, 2, 5))):
                _value(lines, chance)
        case 4:
            for _ in range(chance.randint(1, 4)):
                at, to = chance.randrange(len(lines)), chance.randrange(len(lines))
                lines[at], lines[to] = lines[to], lines[at]
        case _:
            for _ in range(chance.randint(1, 4)):
                at = chance.randrange(len(lines))
                lines[at] = _NUMBER.sub(lambda _: chance.choice(VALUES), lines[at])
    return "\n".join(lines).encode(errors="surrogatepass")


def _scaled(lines: list[str], chance: random.Random) -> None:
    """Another number for some key, of any size, so that it may well be legal."""
    at = chance.choice([at for at, line in enumerate(lines) if "=" in line and _NUMBER.search(line)])
    sizes = (-1.0, 0.0, 1.5, 10.0 ** chance.uniform(-9.0, 9.0), 10.0 ** chance.uniform(-2.0, 2.0))
    factor = chance.choice(sizes)
    lines[at] = _NUMBER.sub(lambda found: repr(float(found[0]) * factor), lines[at])


def _value(lines: list[str], chance: random.Random) -> None:
    """Another value for some key."""
    at = chance.choice([at for at, line in enumerate(lines) if "=" in line])
    lines[at] = f"{lines[at].partition('=')[0]}= {chance.choice(VALUES)}"


def tried(folder: Path, seeds: range) -> Iterator[Tried]:
    """`formation check` on the form of every seed."""
    texts = [path.read_text() for path in shipped().values()]
    path = folder / "mission.toml"
    for seed in seeds:
        chance = random.Random(seed)
        path.write_bytes(form(chance.choice(texts), chance))
        yield attempt("check", seed, lambda: quiet(check.main, [str(path), "--json"]), (Refusal,))
