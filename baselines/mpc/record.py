"""Counts of the model predictive controller about its solves."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field


@dataclass
class MpcRecord:
    """Counts since the last reset.

    Attributes:
        compiled: Whether the stage function is machine code.
        interpreted_because: Why not, else empty.
        commands: Commands given.
        solves: Quadratic programs solved.
        failures: Solves that could not be used, by reason: ``no solution``, ``late``, ``belief``
            (too far from what is predicted) and ``geometry`` (a cable that cannot be).
        fallbacks: What was done instead: ``shifted plan``, ``to rest`` (at equilibrium lengths
            nearby), ``hold`` (braked to rest where it is, as there are no such lengths).
        held: Commands that were changed to keep speed, acceleration, jerk or length within limits.
        softened: Solves whose plan exceeds a soft limit by over 1 %.
        rebased: Beliefs that disagreed with winches at rest for long, and were taken over.
        recovered: How often a plan took over again after the platform had been brought to rest.
        approached: Commands that led back to the reference slowly, from over 0.3 m away.
        no_rest: References at which there is no rest within the tension limits.
        no_cable: Commands with a cable too slack to hang as planned; its last sag was used.
        solve_time: Wall time of the last solve, with its linearisation [s].
        reason: Of the last failure, in words; empty where the last command had none.
    """

    compiled: bool = False
    interpreted_because: str = ""
    commands: int = 0
    solves: int = 0
    failures: Counter[str] = field(default_factory=Counter)
    fallbacks: Counter[str] = field(default_factory=Counter)
    held: int = 0
    softened: int = 0
    rebased: int = 0
    recovered: int = 0
    approached: int = 0
    no_rest: int = 0
    no_cable: int = 0
    solve_time: float = 0.0
    reason: str = ""
