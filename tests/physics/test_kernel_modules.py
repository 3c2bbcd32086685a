import os
import subprocess
import sys

import pytest

from carosac_toolkit.physics import kernel_modules, warp_setup

PROGRAM = """
import importlib
from carosac_toolkit.physics import kernel_modules, warp_setup
kernel_modules.kernel_modules = lambda packages: [
    "carosac_toolkit.physics.motion.winch_kernels", "carosac_toolkit.physics.rest.distance_kernels"
]
warp_setup.NOTICE_DELAY_S = 0.05
kernel_modules.compile_kernels()
"""
PARENT = """
import subprocess, sys
from carosac_toolkit.physics import warp_setup
if {silent}:
    warp_setup.silence_children("cpu")
subprocess.run([sys.executable, "-c", {program!r}], check=True)
"""


def empty_cache(folder):
    """Environment of a process that has to compile, and whose parent has not."""
    kept = {name: x for name, x in os.environ.items() if name != warp_setup.COMPILED_VARIABLE}
    return kept | {"WARP_CACHE_PATH": str(folder)}


def test_two_modules_are_compiled_once_and_told_in_one_line(tmp_path):
    environment = empty_cache(tmp_path)
    told = [
        subprocess.run(
            [sys.executable, "-c", PROGRAM], env=environment, capture_output=True, text=True,
            check=True,
        )
        for _ in range(2)
    ]  # fmt: skip
    assert told[0].stdout == ""
    (line,) = told[0].stderr.splitlines()
    assert line.startswith("Compiling kernels of statics, dynamics and simulator for cpu, once")
    assert told[1].stderr == ""
    assert len(list(tmp_path.rglob("*.o"))) == 2


@pytest.mark.parametrize("silent", [True, False])
def test_children_of_a_process_that_has_compiled_everything_say_nothing(tmp_path, silent):
    done = subprocess.run(
        [sys.executable, "-c", PARENT.format(silent=silent, program=PROGRAM)], check=True,
        env=empty_cache(tmp_path), capture_output=True, text=True,
    )  # fmt: skip
    assert len(done.stderr.splitlines()) == (0 if silent else 1)


def test_every_kernel_module_is_known():
    names = kernel_modules.kernel_modules(("sim_warp", "learned"))
    for name in ("sim_warp.particle_kernels", "learned.length_map_kernels"):
        assert name in names
    assert names.count("carosac_toolkit.physics.rest.hold_kernels") == 1


def test_without_packages_only_the_toolkit_is_searched():
    tops = {name.partition(".")[0] for name in kernel_modules.kernel_modules()}
    assert tops == {"carosac_toolkit"}
