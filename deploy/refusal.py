"""The exception that the command line itself handles, in its own module so that its import is fast."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


class Refusal(Exception):  # noqa: N818 - not an error of the program
    """A request cannot be done; the text is one sentence for the user. Exit code 2."""


@contextmanager
def refused(what: str) -> Iterator[None]:
    """Turn system errors inside into a Refusal: a forbidden folder, a name that is too long."""
    try:
        yield
    except OSError as error:
        blocked = isinstance(error, FileExistsError) and Path(error.filename).is_file()
        why = f"{error.filename} is a file, and no folder" if blocked else error.strerror
        raise Refusal(f"{what}: {why}") from None


@contextmanager
def refusing(kind: type[Exception]) -> Iterator[None]:
    """Turn errors of this kind inside into a Refusal with their text."""
    try:
        yield
    except kind as error:
        raise Refusal(str(error)) from None
