"""A small file that would fill the memory is refused before it is decoded."""

import subprocess
import sys
import zipfile

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from carosac_toolkit.base import file_limits
from carosac_toolkit.base.errors import InvalidFile
from carosac_toolkit.base.npz import read_npz
from carosac_toolkit.recordings.files import load_recording
from carosac_toolkit.studies.run.row_files import read_part


@pytest.fixture(scope="module")
def bomb(tmp_path_factory):
    """A Parquet file of 2 MB that holds 4 GB."""
    file = tmp_path_factory.mktemp("bomb") / "bomb.parquet"
    schema = pa.schema([(f"x{i}", pa.float64()) for i in range(50)])
    column = pa.array(np.zeros(1_000_000))
    table = pa.Table.from_arrays([column] * 50, schema=schema)
    with pq.ParquetWriter(file, schema) as writer:
        for _ in range(10):
            writer.write_table(table)
    assert file.stat().st_size < 3e6
    return file


def test_a_parquet_file_of_4_gb_is_refused_in_little_memory(bomb):
    program = (
        "import resource, sys\n"
        "from pathlib import Path\n"
        "from carosac_toolkit.recordings.files import load_recording\n"
        "try: load_recording(Path(sys.argv[1]))\n"
        "except Exception as error: print(error)\n"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, bomb], capture_output=True, text=True, check=True
    )
    *message, memory = done.stdout.splitlines()
    assert "would take 4000 MB; allowed: up to 537 MB in memory" in " ".join(message)
    assert int(memory) < 1_000_000  # [kB]


def test_rows_of_a_study_are_bounded_too(bomb):
    with pytest.raises(InvalidFile, match="would take 4000 MB"):
        read_part(bomb)


def test_texts_in_a_recording_are_refused_before_they_are_decoded(tmp_path):
    file = tmp_path / "texts.parquet"
    text = pa.DictionaryArray.from_arrays(pa.array(np.zeros(10_000, np.int32)), ["x" * 1_000_000])
    pq.write_table(pa.table({"time_s": text}), file)
    with pytest.raises(InvalidFile, match="'time_s': got type"):
        load_recording(file)


def test_an_npz_file_that_decodes_to_600_mb_is_refused(tmp_path):
    file = tmp_path / "bomb.npz"
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        with archive.open("a.npy", "w", force_zip64=True) as entry:
            for _ in range(60):
                entry.write(bytes(10_000_000))
    with pytest.raises(InvalidFile, match="would take 600 MB"):
        read_npz(file, "rest", "a test", lambda rest, arrays: arrays)


def test_a_csv_file_beyond_the_limit_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(file_limits, "TEXT_BYTES_MAX", 1000)
    file = tmp_path / "long.csv"
    file.write_text("time_s\n" + "1" * 1000)
    with pytest.raises(InvalidFile, match="has 0 MB; allowed: text files up to 0 MB"):
        load_recording(file)
