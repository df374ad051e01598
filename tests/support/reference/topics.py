"""The table of topics in docs/reference/topics.md."""

from __future__ import annotations

from collections.abc import Iterator

from formation.topics import TABLE


def table() -> str:
    """One row for each topic."""

    def rows() -> Iterator[str]:
        yield "| key | message | from → to | rate | QoS | what |"
        yield "|---|---|---|---|---|---|"
        for t in TABLE:
            key = t.pattern.replace("{", "<").replace("}", ">")
            message = " or ".join(name.replace("/msg/", "/") for name in t.types) or "JSON"
            qos = str(t.qos) if t.qos else "queryable"
            yield f"| `{key}` | {message} | {t.sender} → {t.receiver} | {t.rate} | {qos} | {t.purpose} |"

    return "\n".join(rows()) + "\n"
