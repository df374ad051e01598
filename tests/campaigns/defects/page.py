"""What people read of the defects."""

from __future__ import annotations

from collections import Counter

from tests.campaigns.defects.reasons import REASONS
from tests.campaigns.document import Found, head
from tests.campaigns.figures import markdown, verdict

SHARE = 0.95  # share of the defects that is to be found
TITLE = "Deliberate defects"
HEAD = """\
Mistakes that a programmer could make, each built into a copy of the product by itself. A fixed list of
rehearsals then runs on the copy until a rule breaks. If one breaks without a defect, nothing is tried.
"""


def text(found: Found) -> str:
    rows = found["defects"]
    caught, missed = ([row for row in rows if row["found"] is one] for one in (True, False))
    rules = Counter(row["broken"][0]["rule"] for row in caught)
    bar = (f"{len(caught)} of {len(rows)}", verdict(len(caught) >= SHARE * len(rows)))
    where = f"{found['date']}, commit {found['commit']}, {found['machine']}; {found['took'] / 60.0:.0f} min."
    parts = [
        where,
        *([found["note"]] if "note" in found else []),
        markdown(("asked for", "found", ""), [(f"{100 * SHARE:.0f} % are found", *bar)]),
        markdown(("rule that broke first", "defects"), [(rule, str(n)) for rule, n in rules.most_common()]),
        f"Not found, with how many of the {found['plans']} plans each has met:",
        markdown(("defect", "what it breaks", "plans", "why, as supposed"), map(_missed, missed)),
        "Found:",
        markdown(("defect", "what it breaks", "rule", "plans", "plan"), map(_found, caught)),
    ]
    return head(TITLE, "defects", HEAD) + "\n" + "\n\n".join(one.rstrip("\n") for one in parts) + "\n"


def _missed(row: Found) -> tuple[str, ...]:
    why = REASONS.get(row["name"], "not looked into yet")
    return f"`{row['name']}`", row["breaks"], str(row["plans"]), why


def _found(row: Found) -> tuple[str, ...]:
    first = row["broken"][0]
    return f"`{row['name']}`", row["breaks"], first["rule"], str(row["plans"]), f"`{first['plan']}`"
