"""The command line `straightlens`: a group whose commands are found by entry points.

Each package registers its commands under "straightlens.commands" in pyproject.toml, and a command
is imported when it is called, so that no layer has to know those above it. Errors are one line on
stderr: exit code 2 for misuse, 1 for something that failed, 130 after Ctrl-C.
"""

from __future__ import annotations

import logging
import os
import sys
from importlib.metadata import EntryPoint, entry_points

import click

from hybrid.failures import words_of

COMMAND_GROUP = "straightlens.commands"

MISUSE, FAILURE, INTERRUPTED = 2, 1, 130


class LazyGroup(click.Group):
    """A group that imports a command when it is needed."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names of all registered commands."""
        return sorted({*super().list_commands(ctx), *_registered()})

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command, imported now; None if there is none of that name."""
        known = super().get_command(ctx, cmd_name)
        entry = _registered().get(cmd_name)
        if known is not None or entry is None:
            return known
        try:
            return entry.load()
        except ImportError as error:
            message = f"the command {cmd_name!r} cannot be loaded: {error}"
            return _unavailable(cmd_name, message)


def _registered() -> dict[str, EntryPoint]:
    return {entry.name: entry for entry in entry_points(group=COMMAND_GROUP)}


def _unavailable(name: str, message: str) -> click.Command:
    """Stands for a command whose optional dependencies are missing, so that help still works."""

    def complain() -> None:
        raise click.ClickException(message)

    return click.Command(
        name, callback=complain, short_help="(not installed)", add_help_option=True
    )


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="straightlens", prog_name="straightlens")
def straightlens() -> None:
    """Fisheye photographs in, straight photographs and their lens out."""


def run(arguments: list[str] | None = None) -> int:
    """Run a command line and return its exit code.

    Args:
        arguments: Words after the program's name; None takes them from the process.
    """
    try:
        code = straightlens.main(arguments, prog_name="straightlens", standalone_mode=False)
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.ctx.get_help() if error.ctx else error.format_message(), err=True)
        return MISUSE
    except click.UsageError as error:
        name = error.ctx.command_path if error.ctx else "straightlens"
        return _complain(name, error.format_message(), MISUSE)
    except click.ClickException as error:
        return _complain("straightlens", error.format_message(), FAILURE)
    except (click.Abort, KeyboardInterrupt):
        return _complain("straightlens", "interrupted", INTERRUPTED)
    except BrokenPipeError:
        return FAILURE
    except OSError as error:
        return _complain("straightlens", words_of(error), FAILURE)
    except ValueError as error:
        return _complain("straightlens", str(error), FAILURE)
    return code if isinstance(code, int) else 0


def _complain(name: str, message: str, code: int) -> int:
    """Say what went wrong on one line."""
    click.echo(f"{name}: {' '.join(message.split())}", err=True)
    return code


def main() -> None:
    """Entry point of the script `straightlens`."""
    # what decoders log about a broken file is in the error that they raise, too
    for name in ("PIL", "tifffile"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
    sys.exit(run())


if __name__ == "__main__":  # `accelerate launch -m hybrid.cli`
    main()
