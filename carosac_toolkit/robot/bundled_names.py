"""Names of the robots that come with the toolkit; imports nothing heavy."""

from __future__ import annotations

from importlib.resources import files


def list_robots() -> tuple[str, ...]:
    """Name the robots that come with the toolkit, sorted."""
    names = [entry.name for entry in (files("carosac_toolkit.robot") / "bundled").iterdir()]
    return tuple(sorted(name.removesuffix(".yaml") for name in names if name.endswith(".yaml")))
