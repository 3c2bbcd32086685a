"""Marks of tests that need a GPU."""

import pytest
import warp as wp

from carosac_toolkit.physics import warp_setup


def _has_gpu() -> bool:
    warp_setup.initialise()
    return bool(wp.is_cuda_available())


NEEDS_GPU = [
    pytest.mark.gpu,
    pytest.mark.skipif(not _has_gpu(), reason="needs a CUDA device, and Warp finds none"),
]
