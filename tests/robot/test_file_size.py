"""A long robot file is refused soon, and in one short message."""

import time

import pytest

from carosac_toolkit.base.errors import InvalidFile
from carosac_toolkit.robot.file import load_robot


@pytest.mark.parametrize("start", ["", "frame:\n"])
def test_thousands_of_unknown_keys_are_refused_soon(tmp_path, start):
    file = tmp_path / "robot.yaml"
    file.write_text(start + "".join(f" k{i}: 1\n" for i in range(17_000)))
    began = time.process_time()
    with pytest.raises(InvalidFile, match=r"and \d+ more") as caught:
        load_robot(file)
    assert len(caught.value.faults) == 51
    assert time.process_time() - began < 5.0


def test_no_more_of_a_file_is_read_than_is_allowed(tmp_path):
    file = tmp_path / "robot.yaml"
    with file.open("wb") as stream:
        stream.truncate(10**12)  # a hole: it takes no place on the disk
    with pytest.raises(InvalidFile, match="200001 characters; allowed: 200000"):
        load_robot(file)
