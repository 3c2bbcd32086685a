"""View a robot in the browser: at rest, in a live simulation, or in a recorded run.

At rest, to drag the target or move cable lengths: carosac view scampi

Simulated in real time, a controller follows the target that you drag: carosac view scampi --live

Replay of a recording; a second one is its ghost: carosac view synthetic

Two runs of a study's folder: carosac view RESULTS:1 RESULTS:0

Open the address that it prints; Ctrl-C ends it. The page is served to this machine alone, unless
--host says otherwise. --html writes one file that opens without a server, and ends.

Exit status 1 means that an error has ended the live simulation.
"""

from __future__ import annotations

import sys
import time
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from carosac_toolkit.base.errors import CarosacError, InvalidField, did_you_mean
from carosac_toolkit.base.files import check_writable
from carosac_toolkit.cli.common import (
    CommandResult,
    CommonOptions,
    OutputFile,
    check_reach,
    period_of_rate,
    sensors_named,
)
from carosac_toolkit.drivers.simulated import SimulatedDriver
from carosac_toolkit.live.hand_target import HandTarget
from carosac_toolkit.live.real_time import take_priority
from carosac_toolkit.live.rehearsal import rehearse
from carosac_toolkit.loop import plugins
from carosac_toolkit.loop.plugin_builder import build_controller, build_estimator, build_plugin
from carosac_toolkit.loop.plugin_settings import chosen_settings
from carosac_toolkit.physics.motion.winch import PaidOutLengths
from carosac_toolkit.recordings.bundled import list_recordings
from carosac_toolkit.robot.bundled_names import list_robots
from carosac_toolkit.robot.file import load_robot
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.studies.run.run_case import own_settings
from carosac_toolkit.trajectories.catalogue import default_limits
from carosac_toolkit.viewer.live import LiveWatch, follow
from carosac_toolkit.viewer.page import (
    DEFAULT_PORT,
    LOOPBACK_ADDRESS,
    SAG_FACTOR_MAX,
    Page,
)
from carosac_toolkit.viewer.page_process import PageOptions, PageProcess

ROBOT_FILE_SUFFIXES = (".yaml", ".yml")
RESERVED_DRIVER_SETTINGS = (
    "suite",
    "period",
    "real_time",
)  # settings of the driver that options say


@dataclass(frozen=True, kw_only=True)
class Options(CommonOptions):
    """Options of ``carosac view``."""

    what: Annotated[
        tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="WHAT [GHOST]")
    ] = ()
    """A robot (bundled name or YAML file), a recording (bundled name, .parquet, .csv, .mat or
    .jsonl), or the folder of a study, FOLDER:NUMBER for one of its runs; a second recording or
    run is drawn as a ghost."""
    live: tyro.conf.FlagCreatePairsOff[bool] = False
    """Simulate the robot in real time."""
    controller: str = "kinematic_solver"
    """With --live: controller by name, or `module:Class`."""
    estimator: str = "kinematic_solver"
    """With --live: estimator by name, or `module:Class`."""
    driver: str = "simulator"
    """With --live: `simulator`, `quasi_static`, or `module:Class` of a simulated driver."""
    sensors: str = "lengths"
    """With --live: sensors of the driver, such as `lengths+imu`."""
    speed: float | None = None
    """With --live: largest speed of the reference [m/s]; by default 1 m/s on the robot carosac, on
    others by their size."""
    acceleration: float | None = None
    """With --live: its largest acceleration [m/s^2]; by default 1 m/s^2."""
    rate: float = 100.0
    """With --live: commands a second, for a controller whose period can be chosen."""
    settings: Annotated[
        tuple[str, ...], tyro.conf.arg(name="set", metavar="SETTING"), tyro.conf.UseAppendAction
    ] = ()
    """With --live: setting of a plug-in: driver.FIELD=VALUE, such as driver.cables=catenary,
    controller.NAME.FIELD=VALUE or estimator.NAME.FIELD=VALUE; may be given several times."""
    robot: str | None = None
    """The robot to show, instead of WHAT; or the robot of a recording that names none: bundled, or
    a YAML file."""
    sag: float = 1.0
    """Factor by which the distance of the cables from their chords is enlarged; the page says
    so."""
    plain: tyro.conf.FlagCreatePairsOff[bool] = False
    """Serve a page that is cheap to draw, for a browser without a GPU: half the pixels along each
    axis, no floor, no labels at the exits until you choose them."""
    priority: tyro.conf.FlagCreatePairsOff[bool] = False
    """With --live: run the loop before all ordinary processes; on Linux, with the permission to do
    so."""
    html: OutputFile = None
    """Write one HTML file with the robot at rest, or with the replay, and end."""
    host: str = LOOPBACK_ADDRESS
    """Address to serve at; one that other machines can reach needs --allow-others."""
    allow_others: tyro.conf.FlagCreatePairsOff[bool] = False
    """Confirm that other machines may reach --host."""
    port: int = DEFAULT_PORT
    """Port to serve at; if it is taken, the next free one."""
    duration: float | None = None
    """End after this time [s]; with --live, simulated time."""


def run(options: Options) -> CommandResult:
    """Serve, or write, one page."""
    if not options.what and options.robot is not None:
        options = replace(options, what=(options.robot,))
    _check(options)
    if _is_robot(options.what[0]):
        if len(options.what) > 1:
            raise InvalidField("GHOST", repr(options.what[1]), "nothing: a robot has no ghost")
        if options.robot not in (None, options.what[0]):
            allowed = f"one robot; the argument is {options.what[0]!r}"
            raise InvalidField("--robot", repr(options.robot), allowed)
        robot = load_robot(options.what[0])
        return _live(options, robot) if options.live else _statics(options, robot)
    if options.live:
        raise InvalidField("WHAT", repr(options.what[0]), "a robot, with --live")
    return _replay(options)


def _check(options: Options) -> None:
    """Refuse invalid numbers, and combinations that make no sense."""
    if not options.what:
        allowed = "a robot, a recording or a study's folder; see 'carosac view --help'"
        raise InvalidField("WHAT", "nothing", allowed)
    if len(options.what) > 2:
        raise InvalidField("WHAT [GHOST]", f"{len(options.what)} names", "one or two")
    if not 1.0 <= options.sag <= SAG_FACTOR_MAX:
        raise InvalidField("--sag", str(options.sag), f"1 to {SAG_FACTOR_MAX:g}")
    for name in ("speed", "acceleration", "duration"):
        value = getattr(options, name)
        if value is not None and not 0.0 < value < np.inf:
            raise InvalidField(f"--{name}", str(value), "> 0, finite")
    if options.priority and not options.live:
        raise InvalidField("--priority", "it without --live", "--live --priority, for the loop")
    if options.plain and options.html is not None:
        raise InvalidField("--plain", f"it with --html {options.html}", "--plain or --html")
    check_writable("--html", options.html, (".html", ".htm"))
    if options.html is not None and options.live:
        allowed = "no --live; record with carosac run, then carosac view RECORDING --html FILE"
        raise InvalidField("--html", f"'{options.html}'", allowed)
    check_reach(
        "--host", options.host, options.allow_others,
        "see the robot and drag its target, if they know the address of the page or overhear it",
    )  # fmt: skip


def _is_robot(what: str) -> bool:
    """Return whether a name is that of a robot."""
    return what in list_robots() or Path(what).suffix.lower() in ROBOT_FILE_SUFFIXES


def _statics(options: Options, robot: Robot) -> CommandResult:
    """Serve a robot at rest."""
    from carosac_toolkit.viewer.resting import RestingRobot
    from carosac_toolkit.viewer.statics_page import StaticsPage

    RestingRobot(robot)  # refuses before anything is served
    with _page(options, robot, f"{robot.name} at rest") as page:
        if options.html is not None:
            return _still(options, page)
        statics = StaticsPage(page)
        _announce(page.url, "drag the arrows, or choose 'cable lengths'")
        _serve(options)
        statics.close()
        pictures = page.publisher.drawn
        return CommandResult({"url": page.url, "answers": statics.answers, "pictures": pictures})


def _still(options: Options, page: Page) -> CommandResult:
    """Write a file with the robot at rest."""
    from carosac_toolkit.viewer.export import still_html, write_html
    from carosac_toolkit.viewer.resting import RestingRobot

    assert options.html is not None
    picture = RestingRobot(page.robot).home()
    page.draw(picture)
    x, y, z = picture.position
    words = (
        f"at rest at {x:.2f}, {y:.2f}, {z:.2f} m; largest sag {1e3 * picture.sag.max():.1f} mm"
        f"{_enlarged(options)}"
    )
    write_html(options.html, still_html(page, page.robot.name, words))
    print(f"written: {options.html}")
    return CommandResult({"html": str(options.html), "pictures": 1})


def _enlarged(options: Options) -> str:
    """Return a note on sag that is not drawn to scale."""
    return "" if options.sag == 1.0 else f", drawn {options.sag:g} times larger"


def _replay(options: Options) -> CommandResult:
    """Play or write recorded runs."""
    from carosac_toolkit.viewer.export import replay_html, write_html
    from carosac_toolkit.viewer.replay import Replay
    from carosac_toolkit.viewer.runs import load_runs, same_robot

    name = options.what[0]
    if not Path(name).suffix and not Path(name.partition(":")[0]).exists():
        known = [*list_robots(), *list_recordings()]
        if name not in known and "/" not in name:
            hint = did_you_mean(name, known)
            allowed = f"one of {known}, a robot file, a recording or a study's folder{hint}"
            raise InvalidField("WHAT", repr(name), allowed)
    runs = load_runs(name, options.robot)
    ghost = None
    if len(options.what) > 1:
        ghost = len(runs)
        runs = [*runs, *load_runs(options.what[1], options.robot)]
    alike = same_robot(runs)
    if ghost is not None and runs[ghost] not in alike:
        got = f"a run of {runs[ghost].robot.name}"
        raise InvalidField("GHOST", got, f"a run of {runs[0].robot.name}, as the first")
    ghost = None if ghost is None else alike.index(runs[ghost])
    for k, each in enumerate(alike):
        print(f"{k}: {each.name} ({each.duration:.1f} s; {each.source})")
    if len(alike) < len(runs):
        print(f"left out: {len(runs) - len(alike)} runs of other robots")
    with _page(options, alike[0].robot, alike[0].name) as page:
        replay = Replay(page, alike, ghost)
        data = {"runs": [each.name for each in alike], "duration_s": alike[0].duration}
        if options.html is not None:
            words = f"{alike[0].robot.name}; {alike[0].source}{_enlarged(options)}"
            words += "" if ghost is None else f"\nghost: {alike[ghost].name}"
            text, pictures = replay_html(page, replay, alike[0].name, words)
            write_html(options.html, text)
            print(f"written: {options.html}, {pictures} pictures, {len(text) / 1e6:.1f} MB")
            return CommandResult({**data, "html": str(options.html), "pictures": pictures})
        _announce(page.url, "the time line is under 'Move'")
        replay.play(options.duration)
        return CommandResult({**data, "url": page.url, "pictures": replay.pictures})


def _live(options: Options, robot: Robot) -> CommandResult:
    """Run a live simulation."""
    chosen = chosen_settings(
        options.settings, controllers=[options.controller], estimators=[options.estimator]
    )
    period = period_of_rate(options.rate)
    controller = build_controller(options.controller, robot, chosen, period, seed=options.seed)
    estimator = build_estimator(
        options.estimator, robot, chosen, sensors=options.sensors, seed=options.seed
    )
    driver = _driver(options, robot, chosen["driver_settings"], float(controller.period))
    speed, acceleration = default_limits(robot)
    limits = {
        "speed_max": speed if options.speed is None else options.speed,
        "acceleration_max": acceleration if options.acceleration is None else options.acceleration,
    }
    target = HandTarget(robot, robot.home_position, **limits)
    rehearsed = HandTarget(robot, robot.home_position, **limits)
    rehearse(robot, estimator, controller, rehearsed, suite=options.sensors)
    page = PageProcess(
        PageOptions(
            robot=robot, title=f"{robot.name}: {options.controller} with {options.estimator}",
            host=options.host, port=options.port, enlarged=options.sag, plain=options.plain,
        ),
        target.go_to,
    )  # fmt: skip
    try:
        _announce(page.url, "drag the arrows; the controller follows")
        if options.priority:
            take_priority("carosac view", inherited=False)
        watch, error = follow(
            page.instants, driver, estimator, controller, target, duration=options.duration,
            paid_out=PaidOutLengths.of(robot),
        )  # fmt: skip
        if error is not None:
            page.say(f"ENDED: {error}")
    finally:
        page.close()
    return _ended(page, driver, watch, error)


def _ended(
    page: PageProcess, driver: SimulatedDriver, watch: LiveWatch, error: CarosacError | None
) -> CommandResult:
    """Report how a live simulation ended."""
    data = {
        "url": page.url, "cycles": watch.cycles, "overruns": driver.overruns,
        "latency_p99_s": float(np.quantile(watch.latencies, 0.99)) if watch.latencies else None,
        "limits": dict(watch.limits), "pictures": page.drawn,
        "error": None if error is None else str(error),
    }  # fmt: skip
    limits = ", ".join(f"{name} in {count}" for name, count in watch.limits.most_common())
    print(f"{watch.cycles} cycles, {driver.overruns} ticks of the clock missed; {page.drawn} "
          f"pictures; cycles in which a limit changed the command: {limits or 'none'}")  # fmt: skip
    if error is not None:
        print(f"carosac: {error}", file=sys.stderr)
    return CommandResult(data, status=0 if error is None else 1)


def _driver(options: Options, robot: Robot, asked: Any, period: float) -> SimulatedDriver:
    """Make the simulated driver, in real time."""
    plugin = plugins.load("drivers", options.driver)
    if not (isinstance(plugin, type) and issubclass(plugin, SimulatedDriver)):
        allowed = "a simulated driver: simulator, quasi_static; carosac run moves real robots"
        raise InvalidField("--driver", repr(options.driver), allowed)
    own = own_settings(options.driver, asked)
    for name in RESERVED_DRIVER_SETTINGS:
        if name in own:
            raise InvalidField(
                "--set", f"driver.{name}={own[name]!r}", "nothing: an option of the command sets it"
            )
    offered = {"suite": options.sensors, "period": period, "real_time": True}
    with sensors_named():
        driver: SimulatedDriver = build_plugin(
            plugin, robot, where="driver", asked=own, offered=offered, seed=options.seed
        )
    return driver


def _page(options: Options, robot: Robot, title: str) -> closing[Page]:
    """Serve a page until the block ends."""
    page = Page(robot, title, host=options.host, port=options.port, plain=options.plain)
    page.enlarged.value = options.sag
    return closing(page)


def _announce(url: str, words: str) -> None:
    """Print the address of the page."""
    print(f"open {url} in a browser: {words}; Ctrl-C ends", flush=True)


def _serve(options: Options) -> None:
    """Wait for Ctrl-C, or until the time is up."""
    end = None if options.duration is None else time.monotonic() + options.duration
    try:
        while end is None or time.monotonic() < end:
            time.sleep(0.1)
    except KeyboardInterrupt:
        pass
