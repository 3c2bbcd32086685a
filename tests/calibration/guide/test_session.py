from __future__ import annotations

import numpy as np
import pytest

import carosac_toolkit as ct
from calibration.guide.session import real
from tests.calibration.guide.scenes import QUICK, Elsewhere

SCENES = "tests.calibration.guide.scenes"


def read_by_hand(driver):
    options = {"by_hand": True, "enable": False, "reset": False}
    with real(
        ct.load_robot("hangprinter"), "hangprinter", f"{SCENES}:{driver}", QUICK, [], **options
    ) as session:
        return session.mover.rest()


@pytest.mark.parametrize("shift", [0.03, -0.8])
def test_by_hand_lengths_are_those_of_the_driver_wherever_it_stands(monkeypatch, shift):
    """Nothing is homed: neither at the first start nor where a second one goes on elsewhere."""
    first = read_by_hand("Elsewhere")
    monkeypatch.setattr(Elsewhere, "shift", np.array([shift, 0.0, 0.01, 0.0]))
    moved = read_by_hand("Elsewhere")
    assert moved.length - first.length == pytest.approx(Elsewhere.shift, abs=1e-4)


def test_by_hand_tensions_count_where_the_driver_has_load_cells():
    assert read_by_hand("Elsewhere").tension == pytest.approx(
        read_by_hand("Elsewhere").tension, abs=1.0
    )
    assert read_by_hand("WithoutCells").tension is None
