"""Entry point of ``carosac``: finds the command, reads its options, runs it, writes its JSON."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Sequence
from importlib.metadata import EntryPoint
from pathlib import Path
from types import ModuleType

from carosac_toolkit.base.errors import CarosacError, InvalidField, did_you_mean
from carosac_toolkit.base.extras import missing_extras, naming_extras, with_extras
from carosac_toolkit.base.terminal import plain_output, printable
from carosac_toolkit.base.version import __version__
from carosac_toolkit.cli.option_source import read_summary, read_texts
from carosac_toolkit.loop.plugins import entry_points_of, lacking, load

_USAGE_TEMPLATE = """usage: carosac {group}COMMAND [options]

Estimation and control of cable-driven parallel robots whose cables sag.

commands:
{commands}

options of every command:
  -h, --help   what the command does, and its options
  --json FILE  write the numbers that it prints to FILE as well
  --seed N     seed of everything random

exit status: 0 fine; 1 it ran, but the answer is negative; 2 bad input, nothing written"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``carosac`` and return its exit status.

    Args:
        arguments: Command and options; by default those of the process.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    try:
        status = _dispatch(words)
        sys.stdout.flush()
        return status
    except CarosacError as error:
        print(printable(f"carosac: {error}"), file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("carosac: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:  # the reader, such as `head`, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        if error.errno != errno.ENAMETOOLONG:
            raise
        print(f"carosac: {str(error.filename)[:60]!r}...: {error.strerror}", file=sys.stderr)
        return 2


def _dispatch(words: list[str]) -> int:
    """Answer what concerns no single command, or run the command."""
    if not words or words[0] in ("-h", "--help"):
        return _help(bool(words))
    if words[0] == "--version":
        print(f"carosac {__version__}")
        return 0
    name, rest = _command(words)
    if name is None:
        return _help(bool(rest), f"{words[0]}.")
    return _run(name, rest)


def _help(asked: bool, group: str = "") -> int:
    """List the commands; bad input without a command gets this list too."""
    print(_USAGE_TEMPLATE.format(group=group.replace(".", " "), commands=_summaries(group)))
    return 0 if asked else 2


def _commands() -> dict[str, EntryPoint]:
    """Find all commands, ours and those of other installed packages, by name."""
    return {entry.name: entry for entry in sorted(entry_points_of("carosac.commands"))}


def _command(words: list[str]) -> tuple[str | None, list[str]]:
    """Return the command that the words name, and the words after it.

    The entry point ``calibrate.lengths`` is the command ``carosac calibrate lengths``. A group of
    commands without one of them, or with a call for help, has no name.
    """
    group = f"{words[0]}."
    members = [name.removeprefix(group) for name in _commands() if name.startswith(group)]
    if not members:
        return words[0], words[1:]
    if len(words) > 1 and words[1] in members:
        return group + words[1], words[2:]
    if len(words) == 1 or words[1] in ("-h", "--help"):
        return None, words[1:]
    hint = did_you_mean(words[1], members)
    raise InvalidField(f"command after '{words[0]}'", repr(words[1]), f"{', '.join(members)}{hint}")


def _run(name: str, words: list[str]) -> int:
    """Run one command with its own arguments."""
    if name not in _commands():
        spoken = [command.replace(".", " ") for command in _commands()]
        groups = [command for command in spoken if " " in command]
        hint = did_you_mean(" ".join([name, *words[:1]]), groups) or did_you_mean(name, spoken)
        raise InvalidField("command", repr(name), f"{', '.join(spoken)}{hint}")
    from carosac_toolkit.base.files import write_json
    from carosac_toolkit.cli.arguments import parse_options
    from carosac_toolkit.cli.common import CommandResult
    from carosac_toolkit.cli.outputs import check_outputs, mark_outputs

    module: ModuleType = load("commands", name, complete=False)
    options = parse_options(module, name.replace(".", " "), words)  # here --help ends it
    load("commands", name)
    spoken_name = name.replace(".", " ")
    check_outputs(options, spoken_name)
    json_path: Path | None = getattr(options, "json", None)
    try:
        with plain_output(), naming_extras(f"command '{spoken_name}'"):
            answer = module.run(options)
    except InvalidField as error:
        from carosac_toolkit.cli.option_names import name_option

        raise name_option(error, options, words) from error
    except SystemExit as error:
        if error.code:
            raise
        # status 0, although the command has not done its work
        raise CarosacError(
            f"{name}: ended by sys.exit({error.code!r}) in code it called"
        ) from error
    result = answer if isinstance(answer, CommandResult) else CommandResult(status=int(answer))
    mark_outputs(options, spoken_name)
    if json_path is not None:
        write_json(json_path, result.data)
    return result.status


def _summaries(group: str = "") -> str:
    """List the commands of a group with the first line of their docstrings, importing none."""
    commands = {
        name.replace(".", " "): entry
        for name, entry in _commands().items()
        if name.startswith(group)
    }
    width = max((len(name) for name in commands), default=0)
    return "\n".join(f"  {name:<{width}}  {_summary(entry)}" for name, entry in commands.items())


def _summary(entry: EntryPoint) -> str:
    """Read a command's summary from its source."""
    summary = read_summary(entry.module)
    if summary is None:
        return f"(not installed: {entry.value})"
    needed = lacking(entry)
    if needed:
        return f"{summary} Needs {needed}."
    parts = read_texts(entry.module, "EXTRAS_OF_PARTS")
    more = [
        f" Needs {with_extras([extra])} for {part}."
        for extra, part in parts.items()
        if missing_extras([extra])
    ]
    return f"{summary}{''.join(more)}"


if __name__ == "__main__":
    sys.exit(main())
