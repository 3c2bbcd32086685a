import numpy as np

from learned.learning_curve import (
    CURVE_COLUMNS,
    Episode,
    read_curve,
    read_episodes,
    write_curve,
    write_episodes,
)

OLD = """steps,updates,cpu_seconds,reward,median_error_m,median_of_means_m,p95_error_m,rmse_m,inconsistency_m
15040,0,8.22657,-185.701,1.77687,1.74374,2.66079,1.83208,0.0286639
"""  # noqa: E501 - as carosac train wrote it before it counted paths that fail


def row(**changes):
    return dict.fromkeys(CURVE_COLUMNS, 0.123456789) | {"failed_paths": 3.0} | changes


def test_a_curve_is_read_as_it_was_written_to_six_digits_and_counts_to_the_last_one(tmp_path):
    written = [row(steps=1_000_064.0, updates=12_345_678.0), row(steps=2.0, reward=np.nan)]
    write_curve(tmp_path / "curve.csv", written)
    first, second = read_curve(tmp_path / "curve.csv")
    assert (first["steps"], first["updates"], first["failed_paths"]) == (1_000_064, 12_345_678, 3)
    assert first["rmse_m"] == 0.123457
    assert np.isnan(second["reward"])


def test_an_older_curve_does_not_say_how_many_paths_failed(tmp_path):
    (tmp_path / "curve.csv").write_text(OLD)
    (read,) = read_curve(tmp_path / "curve.csv")
    assert np.isnan(read["failed_paths"])
    assert (read["steps"], read["inconsistency_m"]) == (15040.0, 0.0286639)


def test_episodes_are_read_as_they_were_written(tmp_path):
    episodes = [Episode(1_000_064, -0.5, 200), Episode(1_000_064, 12.25, 7)]
    write_episodes(tmp_path / "episodes.csv", episodes)
    assert read_episodes(tmp_path / "episodes.csv") == episodes
    write_episodes(tmp_path / "episodes.csv", [])
    assert read_episodes(tmp_path / "episodes.csv") == []
    assert [path.name for path in tmp_path.iterdir()] == ["episodes.csv"]
