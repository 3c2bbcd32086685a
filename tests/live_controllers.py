"""Controllers that do their work for a while and then fail, each in its own way."""

from __future__ import annotations

import asyncio
import sys
import time

from baselines.kinematic_solver_controller import KinematicSolverController
from carosac_toolkit.live import exit_reasons
from carosac_toolkit.loop.values import Command

AFTER = 0.8  # [s] on the way, where a target is moved by hand


class _Failing(KinematicSolverController):
    cycles = 0

    def command(self, belief, reference):
        self.cycles += 1
        command = super().command(belief, reference)
        return self.fail(command) if self.cycles * self.period > AFTER else command


class Raising(_Failing):
    def fail(self, command):
        raise ZeroDivisionError("a bug")


class Exiting(_Failing):
    def fail(self, command):
        sys.exit()


class Cancelled(_Failing):
    """Raises what a library for tasks would; no `Exception`."""

    def fail(self, command):
        raise asyncio.CancelledError


class Stalling(KinematicSolverController):
    """Takes 0.2 s for each tenth command."""

    cycles = 0

    def command(self, belief, reference):
        self.cycles += 1
        time.sleep(0.2 if self.cycles % 10 == 0 else 0.0)
        return super().command(belief, reference)


class Interrupting(_Failing):
    """Raises what the operator's Ctrl-C would, where nobody has pressed it."""

    def fail(self, command):
        raise KeyboardInterrupt


class ExitingEarly(KinematicSolverController):
    """Ends the program in the rehearsal, before anything is connected."""

    def command(self, belief, reference):
        sys.exit()


class Hanging(_Failing):
    def fail(self, command):
        time.sleep(1000.0)


class Stubborn(_Failing):
    """Hangs and cannot be interrupted."""

    def fail(self, command):
        exit_reasons.INTERRUPT_TIMEOUT_S = 0.3
        while True:
            try:
                time.sleep(1000.0)
            except BaseException:
                continue


class Far(_Failing):
    def fail(self, command):
        return Command(time=command.time, unstrained_length=command.unstrained_length + 3.0)
