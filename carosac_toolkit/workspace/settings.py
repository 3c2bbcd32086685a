"""Demands on a pose of the workspace."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField


@dataclass(frozen=True, kw_only=True)
class WorkspaceSettings:
    """Demands on a pose; tension limits, winch lengths and stability are always demanded.

    Attributes:
        sag: True if cables hang under their own weight; False: straight elastic cables.
        force: Extra forces to be withstood besides the weight, at the platform origin: any within
            plus or minus these along x, y, z of W [N].
        moment: The same of extra moments about x, y, z of W [N m].
        clearance: Least distance between the surfaces of two cables [m]; None: not checked.
        tilt_max: Largest angle of the platform's z axis to that at home [rad]; None: any.
    """

    sag: bool = True
    force: tuple[float, float, float] = (0.0, 0.0, 0.0)
    moment: tuple[float, float, float] = (0.0, 0.0, 0.0)
    clearance: float | None = 0.0
    tilt_max: float | None = None

    def __post_init__(self) -> None:
        """Check every number."""
        for name, unit in (("force", "N"), ("moment", "N m")):
            value = getattr(self, name)
            fits = len(value) == 3 and all(np.isfinite(x) and x >= 0.0 for x in value)
            if not fits:
                raise InvalidField(name, f"{value} {unit}", "three numbers >= 0, for x, y, z")
        if self.clearance is not None and not (np.isfinite(self.clearance)):
            raise InvalidField("clearance", f"{self.clearance} m", "a finite distance or None")
        if self.tilt_max is not None and not 0.0 <= self.tilt_max <= np.pi:
            raise InvalidField("tilt_max", f"{self.tilt_max} rad", "0 to pi rad, or None")

    def wrenches(self) -> Array:
        """Return corners of the box of extra wrenches [N, N m], (K, 6); one of zeros without a box.

        The largest margin is concave in the wrench where cables are straight and the rotation is
        held, so that its least value over the box is at a corner.
        """
        half = np.array([*self.force, *self.moment])
        signs = [(-1.0, 1.0) if size > 0.0 else (0.0,) for size in half]
        corners: Array = np.array(list(product(*signs))) * half
        return corners
