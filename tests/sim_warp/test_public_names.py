"""The public face of the simulator's package: its classes, each imported at its first use."""

import subprocess
import sys

import pytest

import sim_warp


def test_importing_the_package_imports_nothing_that_it_exports():
    program = (
        "import sys, sim_warp; "
        "print([m for m in ('numpy', 'warp', 'carosac_toolkit') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (done.returncode, done.stdout.strip()) == (0, "[]"), done.stderr


def test_every_public_name_is_a_class_of_this_package():
    assert dir(sim_warp) == sim_warp.__all__
    for name in sim_warp.__all__:
        public = getattr(sim_warp, name)
        assert isinstance(public, type), name
        assert (public.__name__, public.__module__.partition(".")[0]) == (name, "sim_warp")


def test_another_name_is_refused():
    with pytest.raises(AttributeError, match="module 'sim_warp' has no attribute 'Simulated'"):
        _ = sim_warp.Simulated
