"""Fixtures that more than one folder of tests uses."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def real_data() -> Path:
    """Folder of the real recordings, which are not part of the project."""
    default = Path(__file__).resolve().parents[1] / ".." / "shared" / "data"
    folder = Path(os.environ.get("CAROSAC_DATA", default)).resolve()
    if not (folder / "scampi_run_part.csv").is_file():
        pytest.skip(f"no real recordings in {folder} (set CAROSAC_DATA)")
    return folder
