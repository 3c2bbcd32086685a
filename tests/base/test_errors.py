import pickle

import pytest

from carosac_toolkit.base.errors import InvalidField, InvalidFile, MissingFile
from carosac_toolkit.base.units import InvalidQuantity

ERRORS = [
    InvalidField("mass", "-1 kg", "> 0 kg"),
    InvalidFile("robot.yaml", ["no mass", "no cables"]),
    MissingFile("robot.yaml", "make one"),
    InvalidQuantity("5 cm^2", "a length in m"),
]


@pytest.mark.parametrize("error", ERRORS, ids=lambda error: type(error).__name__)
def test_errors_come_back_from_a_worker_as_they_were(error):
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is type(error)
    assert str(again) == str(error)
    assert vars(again) == vars(error)
