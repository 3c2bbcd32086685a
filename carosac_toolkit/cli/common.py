"""Options and results that all commands share.

A command is a module named in the entry-point group ``carosac.commands``. The first line of its
docstring is its summary; it has a frozen dataclass ``Options`` that derives from `CommonOptions`
(the docstring of each field is its help), and ``run(options) -> CommandResult``. If one of its uses
alone needs an extra, ``EXTRAS_OF_PARTS`` has the words for it by extra, as a literal.

A field of type `Path`, best as `OutputFile` or `OutputFolder`, is an output and is checked before
``run``; what a command reads is text, as it may be a name or a path.
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar

import tyro

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.local_peer import is_loopback

LOOP_RATE_MAX_HZ = 1000.0  # [Hz]
OutputFile = Annotated[Path | None, tyro.conf.arg(metavar="FILE")]
OutputFolder = Annotated[Path | None, tyro.conf.arg(metavar="DIR")]

RobotArgument = Annotated[
    str, tyro.conf.Positional, tyro.conf.arg(metavar="ROBOT", help_behavior_hint="")
]


@dataclass(frozen=True, kw_only=True)
class CommonOptions:
    """Options that every command has."""

    json: OutputFile = None
    """Write the numbers that the command prints to this file as well."""
    seed: int = 0
    """Seed of everything random; the same seed gives the same numbers."""


@dataclass(frozen=True, kw_only=True)
class RobotOptions(CommonOptions):
    """Options of a command about one robot, which is named as ``ROBOT`` or as ``--robot ROBOT``.

    Once made, `robot` holds the name, however it was given.
    """

    robot_default: ClassVar[str | None] = None  # None: a robot must be named
    robot_argument: RobotArgument = ""
    """A bundled robot (`carosac robots` lists them) or a path to a YAML file."""
    robot: Annotated[str, tyro.conf.arg(metavar="ROBOT", help_behavior_hint="")] = ""
    """The robot, instead of ROBOT."""

    def __post_init__(self) -> None:
        """Settle which robot is meant."""
        if self.robot and self.robot_argument and self.robot != self.robot_argument:
            allowed = f"one robot; the argument is {self.robot_argument!r}"
            raise InvalidField("--robot", repr(self.robot), allowed)
        name = self.robot or self.robot_argument or self.robot_default
        if name is None:
            allowed = "a robot, as ROBOT or --robot ROBOT; carosac robots lists those there are"
            raise InvalidField("ROBOT", "nothing", allowed)
        object.__setattr__(self, "robot", name)


@dataclass(frozen=True, kw_only=True)
class DefaultRobotOptions(RobotOptions):
    """Options of a command that takes the robot ``carosac`` where none is named."""

    robot_default: ClassVar[str | None] = "carosac"
    robot_argument: RobotArgument = ""
    """A bundled robot (`carosac robots` lists them) or a path to a YAML file; by default
    carosac."""


@dataclass(frozen=True)
class CommandResult:
    """Result of a command.

    Attributes:
        data: The numbers it printed; what ``--json`` writes. numpy values are welcome.
        status: Exit status: 0 fine, 1 it ran but the answer is negative.
    """

    data: dict[str, Any] = field(default_factory=dict)
    status: int = 0


@contextlib.contextmanager
def sensors_named() -> Iterator[None]:
    """Name the option in the error of a driver over its setting ``suite``."""
    try:
        yield
    except InvalidField as error:
        if error.field != "suite":
            raise
        raise InvalidField("--sensors", error.value, error.allowed) from error


def period_of_rate(rate: float) -> float:
    """Return the time between two commands of --rate [s].

    Raises:
        InvalidField: A rate [Hz] that is none, or above that of any industrial PLC.
    """
    if not 0.0 < rate <= LOOP_RATE_MAX_HZ:
        raise InvalidField("--rate", f"{rate} Hz", f"over 0 to {LOOP_RATE_MAX_HZ:g} Hz")
    return 1.0 / rate


def check_reach(option: str, address: str, allowed: bool, consequence: str) -> None:
    """Refuse an address that other machines can reach, unless --allow-others confirms it.

    Args:
        option: Option that names the address.
        address: Address to listen on.
        allowed: Whether --allow-others is given.
        consequence: What other machines can then do: ``move ...``.

    Raises:
        InvalidField: It is not confirmed.
    """
    if is_loopback(address):
        return
    words = f"whoever can reach this machine over the network can {consequence}"
    if not allowed:
        confirm = (
            f"an address of this machine only, such as 127.0.0.1; or add --allow-others: {words}"
        )
        raise InvalidField(option, repr(address), confirm)
    print(f"carosac: warning: {words}", file=sys.stderr)
