"""Position as an option of a command: ``--home 0.4 -1.8 3.0``."""

from __future__ import annotations

from typing import Annotated, Any

from tyro.constructors import PrimitiveConstructorSpec

Point = tuple[float, float, float]


def _point(words: list[str]) -> Point:
    """Parse a position."""
    try:
        x, y, z = (float(word) for word in words)
    except ValueError as error:
        raise ValueError("three numbers: X Y Z") from error
    return x, y, z


POSITION_ARGUMENT: PrimitiveConstructorSpec[Any] = PrimitiveConstructorSpec(
    nargs=3,
    metavar="X Y Z",
    instance_from_str=_point,
    is_instance=lambda value: value is None or isinstance(value, tuple),
    str_from_instance=lambda value: ["none"] * 3 if value is None else [str(x) for x in value],
)
Place = Annotated[Point | None, POSITION_ARGUMENT]
