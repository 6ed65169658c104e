"""Puts the command line's own help into the pages, so that it cannot drift.

A line `<!-- help NAME -->` becomes a folded block with what `straightlens NAME --help` prints.
"""

from __future__ import annotations

import re
from typing import Any

import click

from hybrid.cli import straightlens

_MARK = re.compile(r"^<!-- help ([a-z ]+) -->$", re.MULTILINE)
_WIDTH = 88


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Called by MkDocs for each page."""
    return _MARK.sub(lambda mark: _folded(mark[1]), markdown)


def _folded(name: str) -> str:
    lines = help_of(name.split()).splitlines()
    text = "\n".join(f"    {line}".rstrip() for line in lines)
    return f'??? note "All options of `{name}`"\n    ```text\n{text}\n    ```'


def help_of(words: list[str]) -> str:
    """The help of a command or a command's command."""
    command: click.Command = straightlens
    context = click.Context(command, info_name="straightlens", **straightlens.context_settings)
    for word in words:
        assert isinstance(command, click.Group), word
        found = command.get_command(context, word)
        if found is None:
            raise ValueError(f"there is no command {' '.join(words)!r}")
        command = found
        context = click.Context(
            command, parent=context, info_name=word, terminal_width=_WIDTH, max_content_width=_WIDTH
        )
    return command.get_help(context)
