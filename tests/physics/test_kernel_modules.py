import os
import subprocess
import sys

from carosac_toolkit.physics import kernel_modules

PROGRAM = """
import importlib
from carosac_toolkit.physics import kernel_modules, warp_setup
kernel_modules.kernel_modules = lambda packages: [
    "carosac_toolkit.physics.motion.winch_kernels", "carosac_toolkit.physics.rest.distance_kernels"
]
warp_setup.NOTICE_DELAY_S = 0.05
kernel_modules.compile_kernels()
"""


def test_two_modules_are_compiled_once_and_told_in_one_line(tmp_path):
    environment = os.environ | {"WARP_CACHE_PATH": str(tmp_path)}
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


def test_every_kernel_module_is_known():
    names = kernel_modules.kernel_modules(("sim_warp", "learned"))
    for name in ("sim_warp.particle_kernels", "learned.length_map_kernels"):
        assert name in names
    assert names.count("carosac_toolkit.physics.rest.hold_kernels") == 1


def test_without_packages_only_the_toolkit_is_searched():
    tops = {name.partition(".")[0] for name in kernel_modules.kernel_modules()}
    assert tops == {"carosac_toolkit"}
