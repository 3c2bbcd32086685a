"""Fixtures that more than one folder of tests uses."""

from __future__ import annotations

import gc
import os
from pathlib import Path

import pytest

# Tests have small matrices and run side by side: threads of BLAS would only wait for each other.
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # before numpy is imported
    os.environ.setdefault(name, "1")

DOT = bytes.fromhex(  # a picture of one pixel
    "89504e470d0a1a0a0000000d4948445200000001000000010804000000b51c0c02"
    "0000000b4944415478da6364f80f00010501012718e3660000000049454e44ae426082"
)

SLOW = (  # files that begin first, so that no worker is left alone with one of them
    "test_unknown_frame.py", "test_training.py", "test_notebooks.py", "test_examples.py",
    "test_many_runs.py",
)  # fmt: skip


def pytest_sessionstart() -> None:
    """Nothing of what collection makes is garbage: no search for it meanwhile, which takes long."""
    gc.disable()


def pytest_collection_finish() -> None:
    """Search from here on, and among later objects alone."""
    gc.freeze()
    gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the slow files; a file's tests stay together and share fixtures."""
    items.sort(key=lambda item: item.path.name not in SLOW)


@pytest.fixture(scope="module")
def quick_pictures():
    """Figures are made but not rasterised: what they show is tested where they are drawn."""
    from matplotlib.figure import Figure

    def saved(figure, target, **_):
        target.write(DOT) if hasattr(target, "write") else Path(target).write_bytes(DOT)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", saved)
        yield


@pytest.fixture
def blank_pictures(monkeypatch):
    """Reports with nothing drawn in their figures, for tests of other things than pictures."""
    from matplotlib.figure import Figure

    from carosac_toolkit.pictures import comparison, validation

    for module, name in ((comparison, "COMPARISON_PICTURES"), (validation, "VALIDATION_PICTURES")):
        blank = dict.fromkeys(getattr(module, name), lambda _: Figure())
        monkeypatch.setattr(module, name, blank)


@pytest.fixture(scope="session")
def real_data() -> Path:
    """Folder of the real recordings, which are not part of the project."""
    default = Path(__file__).resolve().parents[1] / ".." / "shared" / "data"
    folder = Path(os.environ.get("CAROSAC_DATA", default)).resolve()
    if not (folder / "scampi_run_part.csv").is_file():
        pytest.skip(f"no real recordings in {folder} (set CAROSAC_DATA)")
    return folder
