"""Find where a robot can hold its platform, by how much, and which limit stops it there.

Judges positions on a grid in a box, and on slices through it: tensions within their limits for the
weight and for extra wrenches that you name, lengths that the winches can wind, stability, cables
that do not touch. With six cables or more the orientation is held; with fewer the platform hangs
as it may. Writes pictures and a table of all positions.

With two cables the platform rests in one vertical plane only, which is judged instead of the box.

  carosac workspace carosac
  carosac workspace cogiro --box frame --force 50 50 50 --model both
  carosac workspace ipanema1 --rpy-deg 0,0,0 10,0,0 --slice z=0.5 z=1.5

Exit status 1 means that the robot can hold its platform nowhere in the box.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.files import replacing
from carosac_toolkit.base.numbers import plain
from carosac_toolkit.base.tables import format_table
from carosac_toolkit.cli.common import CommandResult, OutputFolder, RobotOptions
from carosac_toolkit.cli.position_option import Place
from carosac_toolkit.reports.page import check_folder
from carosac_toolkit.robot.file import load_robot
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.robot.sizes import SURFACE_CABLES
from carosac_toolkit.workspace.grid import GRID_AXES, Grid, box_of, search_grid, slice_grid
from carosac_toolkit.workspace.limits import words_of
from carosac_toolkit.workspace.maps import Maps, maps
from carosac_toolkit.workspace.region import Region, compute
from carosac_toolkit.workspace.settings import WorkspaceSettings
from carosac_toolkit.workspace.tables import columns, write_table


@dataclass(frozen=True, kw_only=True)
class Options(RobotOptions):
    """Options of ``carosac workspace``."""

    box: Literal["workspace", "frame"] = "workspace"
    """Box to search: the workspace box of the robot's file, or the box around its exit points."""
    lower: Place = None
    """Lower corner of another box [m]; goes with --upper."""
    upper: Place = None
    """Upper corner of another box [m]."""
    points: int = 20000
    """Approximate number of positions in the box, the cells of the grid."""
    slice: tuple[str, ...] = ()
    """Planes such as x=0.4 z=2 [m]; by default three through the middle of the box."""
    slice_points: int = 2500
    """Approximate number of positions on each plane, the cells of its grid."""
    model: Literal["sag", "straight", "both"] = "sag"
    """Cables that sag, straight ones, or both side by side."""
    rpy_deg: tuple[str, ...] = ()
    """Orientations in all of which a position must be held, each as ROLL,PITCH,YAW in degrees (6
    cables or more); by default that of the home pose."""
    force: Place = None
    """Extra forces to withstand, plus or minus these along x, y, z of the world [N]."""
    moment: Place = None
    """Extra moments to withstand, plus or minus these [N m]."""
    tilt_max_deg: float | None = None
    """Largest tilt of the platform against home [degrees]; by default any."""
    clearance: float = 0.0
    """Least distance between the surfaces of two cables [m]."""
    tensions: Literal["widest", "least"] = "widest"
    """Tensions for the maps of stiffness, frequency and sag: those farthest from their limits, or
    the least ones, as the controllers choose them."""
    output: OutputFolder = None
    """Folder for pictures and tables; by default carosac-results/workspace/ROBOT."""
    pictures: bool = True
    """Draw slices, maps and the boundary in space."""
    table: Literal["csv", "parquet"] = "csv"
    """Format of the table of positions."""


def run(options: Options) -> CommandResult:
    """Find one robot's workspace."""
    robot = load_robot(options.robot)
    lower, upper = _box(options, robot)
    settings = _settings(options)
    turns = _orientations(options, robot)
    grid = search_grid(robot, lower, upper, _count("--points", options.points))
    planes = _planes(options, robot, lower, upper)
    folder = options.output or Path("carosac-results") / "workspace" / robot.name
    check_folder("--output", folder)
    models = ("sag", "straight") if options.model == "both" else (options.model,)
    regions: dict[str, tuple[Region, list[Region]]] = {}
    for model in models:
        asked = replace(settings, sag=model == "sag")
        whole = compute(robot, grid, settings=asked, orientations=turns)
        slices = [compute(robot, p, settings=asked, orientations=turns) for p in planes]
        regions[model] = (whole, slices)
    _print(regions, lower, upper)
    files = _write(options, folder, regions)
    shown = [file.name for file in files if file.suffix not in (".svg", ".pdf")]
    others = ", pictures also as SVG and PDF" if options.pictures else ""
    print(f"\n{len(shown)} files in {folder}: {', '.join(shown)}{others}")
    first = regions[models[0]][0]
    data = {
        "robot": robot.name,
        "box_m": [lower, upper],
        **first.data(),
        "models": {model: region.data() for model, (region, _) in regions.items()},
        "slices": {
            model: [{"plane": _name(r.grid), **r.data()} for r in slices]
            for model, (_, slices) in regions.items()
        },
    }
    if len(regions) == 2:
        data["sag_changes"] = _changes(regions)
    return CommandResult(data, status=0 if first.verdicts.inside.any() else 1)


def _count(option: str, value: int) -> int:
    """Refuse a number of positions outside its range."""
    if not 1 <= value <= 10_000_000:
        raise InvalidField(option, value, "1 to 10000000")
    return value


def _box(options: Options, robot: Robot) -> tuple[Array, Array]:
    """Return the box to search."""
    if options.lower is None and options.upper is None:
        return box_of(robot, options.box)
    if options.lower is None or options.upper is None:
        missing = "--lower" if options.lower is None else "--upper"
        raise InvalidField(missing, "nothing", "three numbers: --lower and --upper go together")
    lower, upper = np.array(options.lower), np.array(options.upper)
    if not (np.isfinite(lower) & np.isfinite(upper) & (lower < upper)).all():
        raise InvalidField("--lower", f"{options.lower} m", f"below --upper, {options.upper} m")
    return lower, upper


def _settings(options: Options) -> WorkspaceSettings:
    """Return the demands on a pose."""
    tilt = options.tilt_max_deg
    if tilt is not None and not 0.0 <= tilt <= 180.0:
        raise InvalidField("--tilt-max-deg", f"{tilt} deg", "0 to 180 deg")
    return WorkspaceSettings(
        force=options.force or (0.0, 0.0, 0.0),
        moment=options.moment or (0.0, 0.0, 0.0),
        clearance=options.clearance,
        tilt_max=None if tilt is None else float(np.radians(tilt)),
    )


def _orientations(options: Options, robot: Robot) -> list[Array] | None:
    """Return the rotations of roll, pitch and yaw."""
    from scipy.spatial.transform import Rotation

    if not options.rpy_deg:
        return None
    if robot.n < 6:
        allowed = f"nothing: the {robot.n} cables of {robot.name} leave the orientation free"
        raise InvalidField("--rpy-deg", options.rpy_deg[0], allowed)
    turns = []
    for text in options.rpy_deg:
        try:
            roll, pitch, yaw = (float(word) for word in text.split(","))
        except ValueError as error:
            allowed = "ROLL,PITCH,YAW in degrees, such as 0,0,30"
            raise InvalidField("--rpy-deg", repr(text), allowed) from error
        turns.append(Rotation.from_euler("xyz", [roll, pitch, yaw], degrees=True).as_matrix())
    return turns


def _planes(options: Options, robot: Robot, lower: Array, upper: Array) -> list[Grid]:
    """Return the grids of the slices; two cables hold in one plane only, which needs none."""
    count = _count("--slice-points", options.slice_points)
    if robot.n == SURFACE_CABLES:
        if options.slice:
            allowed = f"nothing: {robot.name} rests in one plane only, which is drawn"
            raise InvalidField("--slice", repr(options.slice[0]), allowed)
        return []
    if not options.slice:
        middle = 0.5 * (lower + upper)
        return [
            slice_grid(lower, upper, a, float(middle[k]), count) for k, a in enumerate(GRID_AXES)
        ]
    planes = []
    for text in options.slice:
        axis, _, value = text.partition("=")
        try:
            place = float(value)
        except ValueError:
            place = float("nan")
        if axis not in tuple(GRID_AXES) or not np.isfinite(place):
            raise InvalidField("--slice", repr(text), "x=, y= or z= with a number, such as z=2")
        low, high = lower[GRID_AXES.index(axis)], upper[GRID_AXES.index(axis)]
        if not low <= place <= high:
            allowed = f"{axis}={low:g} to {axis}={high:g} m, the box searched"
            raise InvalidField("--slice", repr(text), allowed)
        planes.append(slice_grid(lower, upper, axis, place, count))
    return planes


def _name(grid: Grid) -> str:
    """Return the name of a slice's plane."""
    across = int(np.argmin(grid.shape))
    return f"{GRID_AXES[across]}={grid.axes[across][0]:.6g}"


def _print(regions: dict[str, tuple[Region, list[Region]]], lower: Array, upper: Array) -> None:
    """Print volumes, limits and the effect of sag."""
    for model, (region, slices) in regions.items():
        title = "with sag" if model == "sag" else "straight cables"
        if region.grid.rests:
            plane = region.grid.title
            print(f"two cables let the platform rest in one vertical plane only: {plane}\n")
        print(f"{title}: {region.sentence()}.\n")
        size, unit = region.grid.cell * len(region.verdicts.margin), _unit(region)
        print(
            f"  {plain(region.volume, 4)} {unit} of {plain(size, 4)} {unit}, "
            f"box {_vector(lower)} to {_vector(upper)} m, {len(region.verdicts.margin)} positions"
        )
        inside = region.verdicts.margin[region.verdicts.inside]
        if len(inside):
            print(
                f"  margin inside: {plain(inside.min(), 4)} to {plain(inside.max(), 4)} N, "
                f"median {plain(np.median(inside), 4)} N"
            )
        for part in slices:
            print(f"  slice {_name(part.grid)} m, to the faces of the box: {part.share:.1%} inside")
        ends = {row[:2]: row[2] for row in region.causes(at_the_end=True)}
        rows = [
            (
                words_of(limit, cable),
                region.cable_words(limit, cable) or "-",
                count,
                ends.get((limit, cable), 0),
            )
            for limit, cable, count in region.causes()
        ]
        if rows:
            print(
                "\n"
                + format_table(
                    ("what keeps positions out", "cable", "positions", "at the end"), rows
                )
            )
        print()
    if len(regions) == 2:
        change = _changes(regions)
        by, unit = change["margin_change_N"], _unit(regions["sag"][0])
        end = unit.replace("^", "")
        text = (
            f"sag takes {change['lost']} positions ({plain(change[f'lost_{end}'], 3)} {unit}) away "
            f"from the workspace of straight cables and adds {change['gained']} "
            f"({plain(change[f'gained_{end}'], 3)} {unit})"
        )
        if by["median"] is not None:
            text += (
                f"; where both can, the margin changes by {by['median']:+.3g} N in the median, "
                f"{by['least']:+.3g} N at worst"
            )
        print(text)


def _unit(region: Region) -> str:
    """Return the unit of the size of a workspace."""
    return "m^2" if region.grid.rests else "m^3"


def _vector(values: Array) -> str:
    """Format a vector."""
    return "(" + ", ".join(plain(value, 4) for value in values) + ")"


def _changes(regions: dict[str, tuple[Region, list[Region]]]) -> dict[str, Any]:
    """Compare the workspaces with and without sag."""
    sag, straight = regions["sag"][0], regions["straight"][0]
    one, other = sag.verdicts.inside, straight.verdicts.inside
    lost, gained, both = int((other & ~one).sum()), int((one & ~other).sum()), one & other
    change = sag.verdicts.margin[both] - straight.verdicts.margin[both]
    end = _unit(sag).replace("^", "")
    return {
        "lost": lost,
        "gained": gained,
        f"lost_{end}": lost * sag.grid.cell,
        f"gained_{end}": gained * sag.grid.cell,
        "margin_change_N": {
            "median": float(np.median(change)) if len(change) else None,
            "least": float(change.min()) if len(change) else None,
        },
    }


def _write(
    options: Options, folder: Path, regions: dict[str, tuple[Region, list[Region]]]
) -> list[Path]:
    """Write pictures and tables."""
    from carosac_toolkit.pictures.saving import picture_files

    folder.mkdir(parents=True, exist_ok=True)
    files: list[Path] = []

    def save(name: str, draw: Any) -> None:
        with replacing(folder / name) as temporary:
            draw(temporary)
        files.append(folder / name)

    for model, (whole, slices) in regions.items():
        end = f"-{model}" if len(regions) == 2 else ""
        for name, figure in _figures(options, whole, slices) if options.pictures else ():
            for file, content in picture_files({f"{name}{end}": figure}).items():
                save(file, lambda path, c=content: path.write_bytes(c))
        table = columns(whole, _maps(options, whole))
        save(f"positions{end}.{options.table}", lambda path, t=table: write_table(path, t))
    return files


def _figures(options: Options, whole: Region, slices: list[Region]) -> Iterator[tuple[str, Any]]:
    """Return the pictures of one model by name."""
    from carosac_toolkit.pictures.workspace import draw_maps, draw_slices, draw_space

    if whole.grid.rests:
        yield "plane", draw_slices([whole])
        yield "maps_plane", draw_maps(whole, _maps(options, whole))
        return
    yield "slices", draw_slices(slices)
    yield "space", draw_space(whole)
    for region in slices:
        name = _name(region.grid).replace("=", "_")
        yield f"maps_{name}", draw_maps(region, _maps(options, region))


def _maps(options: Options, region: Region) -> Maps:
    """Compute the maps of one region."""
    return maps(region.robot, region.verdicts, settings=region.settings, tensions=options.tensions)
