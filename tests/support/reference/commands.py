"""docs/reference/commands.md: every command with what its ``--help`` says."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from importlib import import_module
from typing import Never
from unittest.mock import patch

from formation.deploy import cli
from formation.deploy.cli import STEPS, Command
from formation.transport.runtime.command_line import Parser
from tests.support.reference.markdown import document, fenced, paragraph, table

MORE = {
    "replay --verify": Command("deploy.recordings.verify", ""),
    **{f"deploy {name}": step for name, step in STEPS.items()},
}
"""Commands of two words."""
INTRODUCTION = """This is what `formation COMMAND --help` says. A MISSION is a TOML file, a folder of
bundles, or the name of a shipped mission; [mission-keys.md](mission-keys.md) has its keys. A
command that writes a file makes missing folders; an option with one value is given at most once."""
EXIT_CODES = """Exit codes of every command: 0 done as asked; 1 it ran, with another result than asked; 2
refused, nothing was started; 130 interrupted. `replay --verify` also has 3: too little to judge."""


class _Found(Exception):  # noqa: N818 - ends a command as soon as it has made its parser
    def __init__(self, parser: argparse.ArgumentParser) -> None:
        self.parser = parser


def page() -> str:
    parts = [paragraph(INTRODUCTION), paragraph(EXIT_CODES)]
    for group in (cli.HERE, cli.ALONE, cli.FIELD):
        named = {name: command for name, command in cli.COMMANDS.items() if command.group == group}
        rows = ((f"[`{name}`](#formation-{name})", command.summary) for name, command in named.items())
        parts += [f"**{group.capitalize()}**", table(("command", "what"), rows)]
    commands = cli.COMMANDS | MORE
    order = list(cli.COMMANDS)
    for name in sorted(commands, key=lambda name: order.index(name.partition(" ")[0])):
        parts += [f"## formation {name}", *_described(parser_of(commands[name]))]
    return document("Commands", parts)


def parser_of(command: Command) -> argparse.ArgumentParser:
    """The parser of a command, which runs no further than to its ``--help``."""

    def found(parser: argparse.ArgumentParser, _file: object = None) -> Never:
        raise _Found(parser)

    with patch.object(Parser, "print_help", found):
        try:
            getattr(import_module(f"formation.{command.module}"), command.function)(["--help"])
        except _Found as one:
            return one.parser
    raise ValueError(f"{command.module}: has no --help")


def _described(parser: argparse.ArgumentParser) -> Iterator[str]:
    description = parser.description or ""
    yield fenced(description) if "\n" in description else paragraph(description)
    for group in parser._action_groups:
        actions = [one for one in group._group_actions if one.help is not argparse.SUPPRESS]
        rows = [_row(parser, one) for one in actions if "--help" not in one.option_strings]
        if not rows:
            continue
        if group.title not in {"positional arguments", "options"}:
            title = group.title or ""
            yield f"**{title[:1].upper()}{title[1:]}**"
        if group.description:
            yield paragraph(group.description)
        yield table(("argument" if not actions[0].option_strings else "option", "meaning"), rows)
    if parser.epilog:
        yield fenced(parser.epilog)


def _row(parser: argparse.ArgumentParser, action: argparse.Action) -> tuple[str, str]:
    """An argument as it is typed, and what it means."""
    value = action.metavar or action.dest.upper()
    if action.choices and not action.metavar:
        value = f"{{{','.join(map(str, action.choices))}}}"
    shown = " ".join(value) if isinstance(value, tuple) else value
    if action.nargs == 0:
        shown = ""
    elif action.nargs in {"?", "*"}:
        shown = f"[{shown}]" if action.nargs == "?" else f"[{shown} ...]"
    elif action.nargs == "+":
        shown = f"{shown} [{shown} ...]"
    typed = " ".join(part for part in (", ".join(action.option_strings), shown) if part)
    meaning = (action.help or "") % {**vars(action), "prog": parser.prog}
    required = "required; " if action.option_strings and action.required else ""
    return f"`{typed}`", required + meaning
