"""Print the completion of a shell: commands, options, and the names they take.

Bash, in ~/.bashrc:  eval "$(carosac completion bash)"

Zsh, in ~/.zshrc after compinit:  eval "$(carosac completion zsh)"

Fish, once:  carosac completion fish > ~/.config/fish/completions/carosac.fish

It completes commands, options, robots, controllers, estimators, drivers, sensors, trajectories,
conditions, recordings, and files where files are due. The script starts no Python. Names of
plug-ins are those installed when it is printed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import tyro

from carosac_toolkit.cli.common import CommandResult, CommonOptions
from carosac_toolkit.cli.completion_scripts import SCRIPTS
from carosac_toolkit.cli.completion_words import described_commands


@dataclass(frozen=True, kw_only=True)
class Options(CommonOptions):
    """Options of ``carosac completion``."""

    shell: Annotated[
        Literal["bash", "zsh", "fish"], tyro.conf.Positional, tyro.conf.arg(metavar="SHELL")
    ]
    """Shell: `bash`, `zsh` or `fish`."""


def run(options: Options) -> CommandResult:
    """Print the script."""
    commands = described_commands()
    print(SCRIPTS[options.shell](commands))
    return CommandResult({"shell": options.shell, "commands": [one.name for one in commands]})
