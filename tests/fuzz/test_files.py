"""Whatever is in a file, its reader reads it or says in one error of ours why not."""

import warnings
import zlib

import numpy as np
import pytest

from carosac_toolkit.base.errors import CarosacError
from tests.fuzz.mutators import mutated
from tests.fuzz.targets import place, targets

for package in ("onnx", "onnxruntime", "safetensors", "torch", "rosbags"):
    pytest.importorskip(package)

COUNT = 60  # of each kind; `python -m benchmarks.fuzz` takes thousands


@pytest.mark.parametrize("target", targets(), ids=lambda target: target.name)
def test_a_sound_file_is_read(target, tmp_path):
    for seed in target.seeds():
        target.read(place(target, tmp_path, seed))


@pytest.mark.parametrize("target", targets(), ids=lambda target: target.name)
def test_a_damaged_file_is_read_or_refused(target, tmp_path):
    seeds = target.seeds()
    for k in range(max(3, int(COUNT * target.weight))):
        rng = np.random.default_rng([zlib.crc32(target.name.encode()), k])
        content = mutated(seeds[k % len(seeds)], rng, target.mutators)
        path = place(target, tmp_path, content)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                target.read(path)
            except CarosacError as error:
                assert str(error)
