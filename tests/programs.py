"""Programs of the documentation and examples, run in this process.

A process of its own spends most of its time on imports that this one has behind it.
"""

from __future__ import annotations

import runpy
import sys
from contextlib import ExitStack, chdir
from pathlib import Path
from unittest.mock import patch

import matplotlib
import matplotlib.pyplot as plt

from learned.rewards import REWARD_TERMS


def run_here(program: Path, folder: Path) -> None:
    """Run a program as ``python program`` does in a folder; nothing of it is left behind here."""
    with ExitStack() as stack:
        stack.enter_context(chdir(folder))
        stack.enter_context(matplotlib.rc_context())
        stack.enter_context(patch.dict(REWARD_TERMS))  # a program may add its own
        stack.enter_context(patch("sys.argv", [str(program)]))
        stack.enter_context(patch("sys.path", [str(program.parent), *sys.path]))
        stack.callback(plt.close, "all")
        stack.callback(sys.modules.pop, program.stem, None)  # where it names itself
        runpy.run_path(str(program), run_name="__main__")
