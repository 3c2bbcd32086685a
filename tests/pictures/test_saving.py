"""Pictures as files in three formats."""

import os
import subprocess
import sys

import pytest

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.pictures.drawing import new_figure
from carosac_toolkit.pictures.saving import (
    PICTURE_FORMATS,
    check_picture,
    picture_files,
    save_picture,
)

BEGINNINGS = {"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}
DIGESTS = """
import hashlib
from tests.pictures.test_saving import drawn
from carosac_toolkit.pictures.saving import picture_files
for name, content in picture_files({"x": drawn()}).items():
    print(name, hashlib.sha256(content).hexdigest())
"""


def drawn():
    figure = new_figure(3.5, 2.0)
    axes = figure.subplots()
    axes.plot([0.0, 1.0], [1.0, 0.0], "o--", label="a")
    axes.pcolormesh([[0.0, 1.0], [1.0, 0.5]], rasterized=True)
    axes.fill_between([0.0, 1.0], [0.0, 1.0], hatch="///")
    axes.set_xlabel("time [s]")
    axes.legend()
    return figure


def test_a_figure_is_written_in_three_formats():
    files = picture_files({"first": drawn(), "second": drawn()})
    assert list(files) == [f"{name}.{end}" for name in ("first", "second") for end in BEGINNINGS]
    for name, content in files.items():
        assert content.startswith(BEGINNINGS[name.rpartition(".")[2]]), name


def test_equal_figures_are_equal_files_in_every_process():
    seen = set()
    for seed in ("1", "2"):
        environment = {**os.environ, "PYTHONHASHSEED": seed, "SOURCE_DATE_EPOCH": seed}
        done = subprocess.run(
            [sys.executable, "-c", DIGESTS], env=environment, capture_output=True, text=True,
            check=True,
        )  # fmt: skip
        seen.add(done.stdout)
    assert len(seen) == 1 and len(seen.pop().split()) == 2 * len(PICTURE_FORMATS)


def test_vector_files_hold_no_date():
    files = picture_files({"x": drawn()}, ("svg", "pdf"))
    assert b"<dc:date>" not in files["x.svg"] and b"CreationDate" not in files["x.pdf"]


@pytest.mark.parametrize("end", PICTURE_FORMATS)
def test_the_suffix_of_a_file_is_its_format(end, tmp_path):
    assert save_picture(drawn(), tmp_path / f"a.{end}") == [tmp_path / f"a.{end}"]
    assert (tmp_path / f"a.{end}").read_bytes().startswith(BEGINNINGS[end])


def test_without_a_suffix_all_formats_are_written(tmp_path):
    save_picture(drawn(), tmp_path / "a")
    assert {file.name for file in tmp_path.iterdir()} == {f"a.{end}" for end in PICTURE_FORMATS}


def test_other_suffixes_are_refused(tmp_path):
    with pytest.raises(InvalidField, match=r"--picture: .*a\.jpg.*ending in \.png or \.svg or"):
        check_picture("--picture", tmp_path / "a.jpg")
