"""The one exception that the command line itself has to know, on its own so that knowing it costs nothing."""


class Refusal(Exception):  # noqa: N818 - it is no failure of ours
    """What was asked for cannot be done; the text is one sentence for the user. Exit code 2."""
