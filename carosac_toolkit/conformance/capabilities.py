"""Check of a driver's optional members: each belongs to a capability and must have its shape."""

from __future__ import annotations

import inspect
from typing import Any, get_type_hints

from carosac_toolkit.conformance.verdicts import CHECK_SEED, Factory, require
from carosac_toolkit.loop.drive_state import DriveState
from carosac_toolkit.loop.protocols import (
    FaultSource,
    FaultTextSource,
    LinkPatience,
    LinkWatch,
    NamedPlugin,
    StatusSource,
    Supervisor,
    SupportsDisable,
    SupportsEnable,
    SupportsFaultHold,
    SupportsFaultReset,
    SupportsHoming,
    SupportsSetDown,
    TruthSource,
)
from carosac_toolkit.robot.robot import Robot

CAPABILITIES: tuple[type, ...] = (
    NamedPlugin, StatusSource, FaultSource, FaultTextSource, LinkWatch, LinkPatience,
    SupportsHoming, SupportsEnable, SupportsDisable, SupportsFaultReset, SupportsFaultHold,
    SupportsSetDown, TruthSource,
)  # fmt: skip


def capabilities_fit(factory: Factory, robot: Robot) -> None:
    """Each optional member that the guard asks for has the shape of its protocol."""
    driver = factory(robot, seed=CHECK_SEED)
    driver.connect()
    if not isinstance(driver, Supervisor):  # a guard is behind no other, so nobody asks
        for capability in CAPABILITIES:
            _check_capability(driver, capability)
    driver.close()


def _check_capability(driver: Any, capability: type) -> None:
    """Refuse half a capability, and members of another shape."""
    members = {name: x for name, x in vars(capability).items() if not name.startswith("_")}
    missing = [name for name in members if not hasattr(driver, name)]
    if len(missing) == len(members):
        return
    title = capability.__name__
    require(not missing, f"{title}: got no {', '.join(missing)}; allowed: {' and '.join(members)}, "
            "or none of them")  # fmt: skip
    for name, member in members.items():
        value = getattr(driver, name)
        if isinstance(member, property):
            kind = get_type_hints(member.fget)["return"]
            good = isinstance(value, (int, float) if kind is float else kind)
            require(good, f"{title}: {name}: got {value!r}; allowed: {kind.__name__}")
        else:
            _check_method(f"{title}: {name}", member, value)
    if capability is StatusSource:
        words, word = [str(state) for state in DriveState], driver.status()
        require(word in words, f"{title}: status(): got {word!r}; allowed: one of {words}")


def _check_method(title: str, wanted: Any, method: Any) -> None:
    """Refuse what cannot be called with the arguments of the protocol."""
    arguments = list(inspect.signature(wanted).parameters)[1:]
    allowed = f"allowed: a method that takes ({', '.join(arguments)})"
    require(callable(method), f"{title}: got {method!r}; {allowed}")
    signature = inspect.signature(method)
    try:
        signature.bind(*arguments)
    except TypeError:
        require(False, f"{title}: got one that takes {signature}; {allowed}")
