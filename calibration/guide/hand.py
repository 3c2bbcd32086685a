"""Moves by hand: a person puts the platform where the guide says."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from calibration.guide.rest import NotAtRest
from calibration.guide.samples import Rest
from calibration.self_calibration.knowledge import Knowledge
from carosac_toolkit.base.arrays import Array

T = TypeVar("T")


class HandMover:
    """Tells a person where to put the platform, and reads the sensors once it is there.

    Attributes:
        measures_tension: True: whoever moves it keeps all cables taut.
    """

    measures_tension = True

    def __init__(
        self, ask: Callable[[Array, Array], None], read: Callable[[], Rest],
        again: Callable[[str], None] = lambda why: None,
    ) -> None:  # fmt: skip
        """Take how to ask for a position, and how to read the sensors.

        Args:
            ask: Called with the present and the wanted position in W [m], each of shape (3,);
                returns once the platform rests near the wanted one.
            read: Returns the readings there.
            again: Called with the reason where the platform did not rest; returns once it does.
        """
        self._ask, self._read, self._again = ask, read, again

    def rest(self) -> Rest:
        """Read the sensors, as often as it takes until the platform rests."""
        while True:
            try:
                return self._read()
            except NotAtRest as error:
                self._again(str(error))

    def while_holding(self, work: Callable[[], T]) -> T:
        """Compute; nothing moves meanwhile."""
        return work()

    def move(self, known: Knowledge, start: Array, end: Array) -> str:
        """Have the platform put somewhere else [m]; at the start it is there already."""
        if (start != end).any():
            self._ask(start, end)
        return ""
