"""Check that what is imported is the wheel in a given environment, whole with its data."""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.resources import files
from pathlib import Path

PACKAGES = ("carosac_toolkit", "baselines", "sim_warp", "learned", "calibration")
ROBOTS = (
    "carosac", "cogiro", "desktop", "hangprinter", "ipanema1", "scampi", "stadium", "warehouse",
)  # fmt: skip
EXTRAS = ("all", "calibration", "control", "learn", "parallel", "ros", "view")
DATA = (
    "py.typed",
    "recordings/data/synthetic.parquet",
    *(f"robot/bundled/{name}.yaml" for name in ROBOTS),
)


def main() -> None:
    """Fail with an assertion where something is missing or comes from elsewhere."""
    environment = Path(sys.argv[1]).resolve()
    for name in PACKAGES:
        found = Path(str(import_module(name).__file__)).resolve()
        assert found.is_relative_to(environment), f"{name} comes from {found}"
    toolkit = files("carosac_toolkit")
    for name in DATA:
        assert toolkit.joinpath(name).is_file(), f"{name} is not in the wheel"

    import carosac_toolkit as ct
    from carosac_toolkit.base.extras import missing_extras
    from carosac_toolkit.recordings.bundled import list_recordings

    assert ct.list_robots() == ROBOTS
    for robot in ct.list_robots():
        ct.load_robot(robot)
    assert list_recordings()
    assert missing_extras(EXTRAS) == EXTRAS, "the environment holds packages of an extra"
    licences = list(environment.rglob("carosac_toolkit-*.dist-info/licenses/LICENSE"))
    assert len(licences) == 1, licences
    print(f"the wheel in {environment.name} is whole: {', '.join(PACKAGES)}")


if __name__ == "__main__":
    main()
