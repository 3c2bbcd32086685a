"""A small file that would fill the memory is refused before it is decoded."""

import time
import zipfile

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from carosac_toolkit.base import file_limits
from carosac_toolkit.base.errors import InvalidFile
from carosac_toolkit.base.npz import read_npz
from carosac_toolkit.recordings.columns import channel_columns
from carosac_toolkit.recordings.files import load_recording, save_recording
from carosac_toolkit.studies.run.row_files import read_part
from tests.memory import peak_of
from tests.recordings.synthetic import full_recording


@pytest.fixture(scope="module")
def bomb(tmp_path_factory):
    """A Parquet file of 2 MB that holds 4 GB."""
    file = tmp_path_factory.mktemp("bomb") / "bomb.parquet"
    names = ["time_s", *(f"unstrained_length_{i:02d}_m" for i in range(1, 50))]
    schema = pa.schema([(name, pa.float64()) for name in names])
    column = pa.array(np.zeros(1_000_000))
    table = pa.Table.from_arrays([column] * 50, schema=schema)
    with pq.ParquetWriter(file, schema) as writer:
        for _ in range(10):
            writer.write_table(table)
    assert file.stat().st_size < 3e6
    return file


def test_a_parquet_file_of_4_gb_is_refused_in_little_memory(bomb):
    assert peak_of(load_recording, bomb) < 400e6
    with pytest.raises(InvalidFile, match="has 4000 MB of numbers"):
        load_recording(bomb)


@pytest.fixture(scope="module")
def hours(tmp_path_factory):
    """A Parquet file of 1 MB whose numbers take 134 MB."""
    file = tmp_path_factory.mktemp("hours") / "hours.parquet"
    rows, n = 500_000, 33
    columns = {f"unstrained_length_{i:02d}_m": np.ones(rows) for i in range(1, n + 1)}
    pq.write_table(pa.table({"time_s": 0.01 * np.arange(rows)} | columns), file, compression="zstd")
    return file


def test_an_accepted_recording_takes_a_little_more_than_its_numbers(hours):
    assert peak_of(load_recording, hours) < 1.3 * 134e6 + 60e6


def test_numbers_beyond_the_limit_are_refused(hours, monkeypatch):
    monkeypatch.setattr(file_limits, "VALUES_BYTES_MAX", 100e6)
    with pytest.raises(InvalidFile, match="MB of numbers; allowed: up to 100: cut it, or leave"):
        load_recording(hours)


def test_clocks_of_their_own_do_not_count_as_numbers(tmp_path, monkeypatch):
    """Eight cables: the table is mostly empty cells, which are no content."""
    recording = full_recording(8)
    numbers = 8 * sum(
        len(time) * (1 + len(channel_columns(channel, 8)))
        for channel, time in recording.channel_times.items()
    )
    monkeypatch.setattr(file_limits, "VALUES_BYTES_MAX", 1.1 * numbers)
    for suffix in (".parquet", ".csv"):
        save_recording(recording, tmp_path / f"run{suffix}")
        assert load_recording(tmp_path / f"run{suffix}").rates == recording.rates


def test_what_would_not_be_read_is_not_written(tmp_path, monkeypatch):
    monkeypatch.setattr(file_limits, "VALUES_BYTES_MAX", 1000)
    for suffix in (".parquet", ".csv"):
        with pytest.raises(InvalidFile, match="MB of numbers"):
            save_recording(full_recording(4), tmp_path / f"run{suffix}")
    monkeypatch.undo()
    monkeypatch.setattr(file_limits, "TEXT_BYTES_MAX", 1000)
    with pytest.raises(InvalidFile, match="MB of text"):
        save_recording(full_recording(4), tmp_path / "run.csv")
    assert not list(tmp_path.iterdir())


def test_rows_of_a_study_are_bounded_too(bomb):
    with pytest.raises(InvalidFile, match="would take 4000 MB"):
        read_part(bomb)


def test_a_text_that_many_rows_share_counts_for_each(tmp_path):
    file = tmp_path / "part-00000000.parquet"
    text = pa.DictionaryArray.from_arrays(np.zeros(200_000, np.int32), ["z" * 3000])
    table = {"case": text.cast(pa.string()), "status": pa.array(["ok"] * 200_000)}
    pq.write_table(pa.table(table), file, store_schema=False)
    assert file.stat().st_size < 100_000
    with pytest.raises(InvalidFile, match="MB; allowed: up to 537 MB in memory"):
        read_part(file)


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_thousands_of_columns_are_refused_at_once(tmp_path, kind):
    file = tmp_path / f"wide.{kind}"
    names = [f"a{i}" for i in range(3000)]
    if kind == "csv":
        file.write_text(",".join(names) + "\n" + "1," * 2999 + "1\n")
    else:
        pq.write_table(pa.table({name: [1.0] for name in names}), file)
    with pytest.raises(InvalidFile, match="has 3000 columns; allowed: up to 1000"):
        load_recording(file)


def test_hundreds_of_unknown_columns_are_named_without_a_search_for_each(tmp_path):
    file = tmp_path / "wide.csv"
    names = [f"unstrained_length_999_m{i}" for i in range(900)]
    file.write_text(",".join([*names, "unstrained_length_999_m"]) + "\n" + "1," * 900 + "1\n")
    began = time.process_time()
    with pytest.raises(InvalidFile, match=r"and \d+ more"):
        load_recording(file)
    assert time.process_time() - began < 5.0


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
    with pytest.raises(InvalidFile, match=r"MB of text; allowed: up to 0\.001 MB: cut it"):
        load_recording(file)
