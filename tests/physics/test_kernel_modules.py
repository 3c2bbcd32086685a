import os
import subprocess
import sys

from carosac_toolkit.physics import kernel_modules

PROGRAM = """
import importlib
from carosac_toolkit.physics import kernel_modules, warp_setup
kernel_modules.kernel_modules = lambda: [
    "carosac_toolkit.physics.motion.winch_kernels", "carosac_toolkit.physics.rest.distance_kernels"
]
warp_setup.NOTICE_DELAY_S = 0.0
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
    assert line.startswith("Compiling 2 kernel modules for cpu, once on this machine")
    compiled = sorted(path.name for path in tmp_path.rglob("*.o"))
    assert len(compiled) == 2
    assert sorted(path.name for path in tmp_path.rglob("*.o")) == compiled


def test_every_kernel_module_is_known():
    names = kernel_modules.kernel_modules()
    for name in ("sim_warp.particle_kernels", "learned.length_map_kernels"):
        assert name in names
    assert names.count("carosac_toolkit.physics.rest.hold_kernels") == 1
