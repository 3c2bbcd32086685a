"""The public face of the package: all names exist, and importing it is cheap."""

from __future__ import annotations

import subprocess
import sys

import pytest

import calibration


@pytest.mark.parametrize("name", calibration.__all__)
def test_every_public_name_can_be_imported(name):
    assert name in dir(calibration)
    assert getattr(calibration, name).__name__ == name


def test_an_unknown_name_is_refused():
    with pytest.raises(AttributeError, match="module 'calibration' has no attribute 'calibrate'"):
        calibration.calibrate  # noqa: B018


def test_importing_the_package_loads_no_library():
    program = "import sys, calibration; print(*{name.partition('.')[0] for name in sys.modules})"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert not {"numpy", "scipy", "gtsam", "matplotlib", "geocompy"} & set(done.stdout.split())
