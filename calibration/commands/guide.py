"""Guide a robot, or a person who moves it, to where it learns its geometry.

From home the robot goes slowly to the position that teaches most about its exit points by what is
known by then, rests, and is fitted anew, until the exit points are as accurate as wanted. Then ten
moves are predicted before they are made: their errors against the claim are the verdict.

Every sample is on the disk before the next move. Started again with the same file, the guide goes
on where it was stopped. Without --enable nothing moves, but for the simulated robot.

Exit status 1 means that the accuracy was not reached, or that the verdict is negative; 128 and the
number of a signal, such as 130, that it was stopped.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from calibration.guide import progress as shown
from calibration.guide.drivers import check_speed
from calibration.guide.fit import exit_distances
from calibration.guide.guide import Guide, Progress
from calibration.guide.rest import Stopped
from calibration.guide.samples import SampleFile
from calibration.guide.session import SIMULATED, Session, real, simulated
from calibration.guide.settings import GuideSettings
from calibration.guide.simulated import taped_distance
from calibration.guide.verdict import Verdict, aligned_errors
from calibration.guide.view import GuideView
from calibration.report import print_sentences, write_new_robot
from calibration.robot_update import check_output
from calibration.self_calibration.calibrate import calibrate_motor_angles
from calibration.self_calibration.command import prior_settings
from calibration.self_calibration.problem import check_drums
from calibration.self_calibration.settings import SelfCalibrationSettings
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.cli.common import CommandResult, CommonOptions, OutputFile
from carosac_toolkit.robot.file import load_robot
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.viewer.page import DEFAULT_PORT, Page

Shown = Callable[[Progress], None]
POINT_SHARE = 0.02  # of the longest cable: anchor points closer together count as one


@dataclass(frozen=True, kw_only=True)
class Options(CommonOptions):
    """Options of ``carosac calibrate guide``."""

    samples: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SAMPLES")]
    """CSV of the samples, a file of motor angles; one that exists is gone on with."""
    robot: str = "hangprinter"
    """A bundled robot or a YAML file, with drums; its platform must be at home, all cables taut."""
    driver: str = SIMULATED
    """Driver: `quasi_static` (a simulated robot that differs from its file), `ads` (a PLC), or
    `module:Class`. It must give lengths; tensions too, unless the platform is moved by hand."""
    true_robot: str | None = None
    """Simulated robot: the true one, a YAML file; by default one is drawn, by --seed, that the
    robot file may be a first guess of."""
    tape: Annotated[tuple[tuple[str, str], ...], tyro.conf.arg(metavar="A B")] = ()
    """Simulated robot: exit points, by cable, or one and home, whose distance is measured with a
    tape, to 1 mm, at the start."""
    distance: Annotated[
        tuple[tuple[str, str, float, float], ...], tyro.conf.arg(metavar="A B LENGTH SIGMA")
    ] = ()
    """Measured distances between exit points, by cable, or from one to home, with their standard
    deviations [m], such as a b 2.481 0.001."""
    home_length_prior: float = SelfCalibrationSettings.length_at_zero_sigma
    """Standard deviation of the lengths at home in the robot file [m]."""
    radius_prior: float = SelfCalibrationSettings.drum_radius_sigma
    """Standard deviation of the drums' radius in the robot file [m]."""
    keeps_rotation: tyro.conf.FlagCreatePairsOff[bool] = False
    """The platform keeps its rotation from home by its build, though its cables end apart."""
    by_hand: tyro.conf.FlagCreatePairsOff[bool] = False
    """Say where to put the platform and wait for Enter, instead of moving it."""
    enable: tyro.conf.FlagCreatePairsOff[bool] = False
    """Let the winches of a real robot move."""
    reset: tyro.conf.FlagCreatePairsOff[bool] = False
    """Clear the fault that a PLC holds from an earlier run, once you know why it came."""
    accuracy: float = GuideSettings.accuracy
    """Wanted standard deviation of the exit points, the mean of their distances from the truth
    [m]; turns of the whole robot about home, which no length tells, left out."""
    max_samples: int = GuideSettings.max_samples
    """Samples after which the guide gives up."""
    checks: int = GuideSettings.checks
    """Moves that are predicted before they are made."""
    view: tyro.conf.FlagCreatePairsOff[bool] = False
    """Serve a page on this machine that shows each sample, and the exit points with ellipsoids of
    two sigmas."""
    port: int = DEFAULT_PORT
    """With --view: port to serve at; if it is taken, the next free one."""
    speed: float = GuideSettings.speed
    """Largest speed of the platform [m/s]; slower where tensions may change quickly."""
    settings: Annotated[
        tuple[str, ...], tyro.conf.arg(name="set", metavar="SETTING"), tyro.conf.UseAppendAction
    ] = ()
    """Setting of a real driver, driver.FIELD=VALUE; may be given several times."""
    output: OutputFile = None
    """The new robot file; never the old one."""


def run(options: Options) -> CommandResult:
    """Guide one robot."""
    settings = GuideSettings(
        accuracy=options.accuracy, max_samples=options.max_samples, checks=options.checks,
        speed=options.speed,
    )  # fmt: skip
    robot = load_robot(options.robot)
    check_drums(robot)
    _check_platform(options, robot)
    _check_options(options)
    check_speed(settings.speed, robot)
    check_output("--output", options.output, options.robot)
    with SampleFile.held(Path(options.samples), robot) as samples:
        return _run(options, robot, samples, settings)


def _run(
    options: Options, robot: Robot, samples: SampleFile, settings: GuideSettings
) -> CommandResult:
    """Guide one robot, with its samples."""
    with _page(options, robot) as page, _session(options, robot, settings) as session:
        priors = _priors(options, session)
        guide = Guide(robot, session.mover, samples, settings, priors, seed=options.seed)
        try:
            resumed = guide.resume()
            with _going_on_from(samples):
                show = _showing(guide, page)
                verdict = _guided(options, guide, session, settings, show, fresh=resumed is None)
        except Stopped as error:
            print(f"\nstopped: {error}; the same command goes on from {options.samples}")
            number = None if session.ending is None else session.ending.signal
            status = 1 if number is None else 128 + number
            return CommandResult({"samples": len(samples.names)}, status=status)
    print()
    print_sentences(_sentences(guide, session, verdict))
    refused = verdict is not None and not verdict.holds
    if options.output is not None and refused:
        print(f"\nno new robot file is written: the verdict is negative ({options.output})")
    elif options.output is not None:
        noise = replace(priors, line_sigma=guide.known.line_sigma, accuracy=options.accuracy)
        result = calibrate_motor_angles(samples.measured(), robot, noise)
        provenance = f"guided self-calibration, samples in {samples.path.name}"
        write_new_robot(result, options.robot, options.output, provenance=provenance)
        if result.frame.level:
            print("it is upright by the measured tensions; the positions above lean against it")
    data = {
        "robot": robot.name,
        "samples": len(samples.measured().samples),
        "accurate": guide.accurate,
        "exit_distance_m": guide.known.exit_distance,
        "exit_distances_m": dict(zip(robot.cable_names, exit_distances(guide.known), strict=True)),
        "exit_points_m": dict(zip(robot.cable_names, guide.known.exit_points, strict=True)),
        "verdict": None if verdict is None else verdict.data(),
    }
    return CommandResult(data, status=0 if guide.accurate and not refused else 1)


def _priors(options: Options, session: Session) -> SelfCalibrationSettings:
    """Return what is known before, distances included."""
    known = prior_settings(options)
    distances = [*known.distances]
    for first, second in options.tape:
        assert session.true_robot is not None
        one = taped_distance(session.true_robot, first, second, options.seed)
        print(f"tape: --distance {first} {second} {one.length:.4f} {one.sigma:g}")
        distances.append(one)
    return replace(
        known, friction_share=0.0, distances=tuple(distances)
    )  # load cells at the platform


def _session(options: Options, robot: Robot, settings: GuideSettings) -> Any:
    """Return the robot that is moved, as a context."""
    if options.driver == SIMULATED:
        return simulated(
            robot, options.true_robot, settings, by_hand=options.by_hand, seed=options.seed
        )
    return real(
        robot, options.robot, options.driver, settings, options.settings,
        by_hand=options.by_hand, enable=options.enable, reset=options.reset,
    )  # fmt: skip


@contextlib.contextmanager
def _page(options: Options, robot: Robot) -> Iterator[Page | None]:
    """Serve a page while the robot is guided, if one is wanted."""
    if not options.view:
        yield None
        return
    page = Page(robot, f"guide: {robot.name}", port=options.port, moves=False)
    try:
        print(f"watch it at {page.url}", flush=True)
        yield page
    finally:
        page.close()


def _showing(guide: Guide, page: Page | None) -> Shown:
    """Return what prints a sample, and draws it if there is a page."""
    view = None if page is None else GuideView(page, guide.known, guide.fit)

    def show(sample: Progress) -> None:
        print(shown.line(sample), flush=True)
        if view is not None:
            view.show(sample)

    return show


def _guided(
    options: Options, guide: Guide, session: Session, settings: GuideSettings, show: Shown,
    *, fresh: bool,
) -> Verdict | None:  # fmt: skip
    """Collect and check; print each sample, and show it."""
    robot = guide.known.problem.robot
    print_sentences(
        [
            f"robot {robot.name}: wanted are exit points to {1e3 * settings.accuracy:.3g} mm "
            f"on average, with {settings.max_samples} samples at most; "
            + shown.before(guide.known, len(guide.samples.names))
        ],
        "",
    )
    if guide.finished:
        print("all samples and checks are there already")
        return Verdict(checks=guide.checked) if settings.checks else None
    if options.by_hand:
        print("A hand's breadth does not matter at the positions below, but pull all cables taut.")
    print("\n" + shown.header())
    truth = session.true_position
    place: list[Array] = []
    true: list[Array] = []
    for sample in guide.collect():
        show(sample)
        if truth is not None:
            true.append(truth())
    assert guide.fit is not None
    if settings.checks == 0:
        return None
    print("moves that are predicted before they are made:")
    place = list(guide.fit.position)
    for check in guide.check():
        assert check.surprise is not None
        show(check)
        place.append(check.position)
        if truth is not None:
            true.append(truth())
    checks = guide.checked
    error = None
    if fresh and truth is not None:
        error = aligned_errors(place, true, robot.home_position)[-len(checks) :]
    return Verdict(checks=checks, position_error=error)


@contextlib.contextmanager
def _going_on_from(samples: SampleFile) -> Iterator[None]:
    """Count every error as a stop once there is a sample: another run goes on from it."""
    try:
        yield
    except CarosacError as error:
        if isinstance(error, Stopped) or not samples.names:
            raise
        raise Stopped(str(error)) from error


def _sentences(guide: Guide, session: Session, verdict: Verdict | None) -> list[str]:
    """Return the outcome in words, the verdict last."""
    known, largest = 1e3 * guide.known.exit_distance, 1e3 * float(exit_distances(guide.known).max())
    count = len(guide.samples.measured().samples)
    lines = [
        f"{count} samples; the exit points are known to {known:.1f} mm on average, the worst to "
        f"{largest:.1f} mm (1 sigma), but for a turn of the whole robot about home, which no "
        "length tells"
    ]
    if not guide.accurate:
        lines.append(
            "the wanted accuracy was NOT reached; go on with a larger --max-samples, or measure "
            "a distance (--distance), as the lengths at home and the drums tell the scale poorly"
        )
    return lines + (["no moves were checked"] if verdict is None else verdict.sentences())


def _check_platform(options: Options, robot: Robot) -> None:
    """Refuse robots whose lengths tell nothing, or whose platform is no point."""
    if robot.n <= 3:
        allowed = "at least 4 cables: the lengths of 3 tell a position, and nothing of the robot"
        raise InvalidField("robot", f"{robot.name!r} with {robot.n} cables", allowed)
    apart = float(np.ptp(robot.anchor_points, axis=0).max())
    longest = float(np.linalg.norm(robot.exit_points - robot.home_position, axis=1).max())
    if apart > POINT_SHARE * longest and not options.keeps_rotation:
        got = f"anchor points {apart:.3g} m apart on the platform of {robot.name!r}"
        allowed = (
            f"a point-like platform, under {POINT_SHARE * longest:.3g} m, or --keeps-rotation "
            "for one that is built to; others need measured poses: carosac calibrate lengths"
        )
        raise InvalidField("robot", got, allowed)


def _check_options(options: Options) -> None:
    """Refuse options that are without effect."""
    simulation = options.driver == SIMULATED
    if simulation and (options.enable or options.settings):
        name = "--enable" if options.enable else "--set"
        raise InvalidField(name, "given", f"not with --driver {SIMULATED}, which is simulated")
    for name, value in (("--true-robot", options.true_robot), ("--tape", options.tape)):
        if not simulation and value:
            raise InvalidField(name, value, f"with --driver {SIMULATED} only")
    if options.port != DEFAULT_PORT and not options.view:
        raise InvalidField("--port", str(options.port), "with --view only")
    if options.driver == "simulator":
        allowed = f"{SIMULATED}, whose robot may differ from its file, or a real driver"
        raise InvalidField("--driver", "'simulator'", allowed)
