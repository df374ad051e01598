"""The one exception that the command line itself has to know, on its own so that knowing it costs nothing."""

from collections.abc import Iterator
from contextlib import contextmanager


class Refusal(Exception):  # noqa: N818 - it is no failure of ours
    """What was asked for cannot be done; the text is one sentence for the user. Exit code 2."""


@contextmanager
def refused(what: str) -> Iterator[None]:
    """What the system says no to in here is refused: a folder nobody may enter, a name that is too long."""
    try:
        yield
    except OSError as error:
        raise Refusal(f"{what}: {error.strerror}") from None
