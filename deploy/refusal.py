"""The exception that the command line itself handles, in its own module so that its import is fast."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


class Refusal(Exception):  # noqa: N818 - not an error of the program
    """A request cannot be done; the text is one sentence for the user. Exit code 2."""


@contextmanager
def refuse_os_errors(what: str) -> Iterator[None]:
    """Turn system errors inside into a Refusal: a forbidden folder, a name that is too long."""
    try:
        yield
    except OSError as error:
        raise Refusal(f"{what}: {_why(error)}") from None


def _why(error: OSError) -> str | None:
    """Return why a file cannot be had; where a folder should be and a file is, its name."""
    if isinstance(error, (FileExistsError, NotADirectoryError)) and error.filename is not None:
        path = Path(error.filename)
        for one in (path, *path.parents):
            if one.is_file():
                return f"{one} is a file, and no folder"
    return error.strerror


@contextmanager
def refuse_errors(kind: type[Exception]) -> Iterator[None]:
    """Turn errors of this kind inside into a Refusal with their text."""
    try:
        yield
    except kind as error:
        raise Refusal(str(error)) from None
