"""The guide: to the next most informative position that is safe, a sample, a fit, and again."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from calibration.guide.fit import GuideFit, Surprise, first, nothing_measured, refit, surprises
from calibration.guide.mover import Mover
from calibration.guide.samples import CHECK_PREFIX, HOME_SAMPLE, Rest, SampleFile
from calibration.guide.settings import GuideSettings
from calibration.self_calibration.balance import operating_tensions
from calibration.self_calibration.knowledge import Knowledge
from calibration.self_calibration.settings import SelfCalibrationSettings
from calibration.self_calibration.suggested_positions import (
    Reach,
    safe_positions,
    suggest_positions,
)
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.robot.robot import Robot

TAUT_SHARE = 0.5  # of the way from the lower limit to the lowest tension used on purpose
FOREIGN_CHANCE = 1e-6  # of lengths as far off by chance, below which they are of another robot
RANDOM_CANDIDATES = 60  # positions of which the first one that is safe is taken
ATTEMPTS_MAX = 10  # moves in a row that end with slack cables, after which the guide gives up
SHORTER = 0.5  # ratio of the next reach to the last after such a move


@dataclass(frozen=True, kw_only=True, eq=False)
class Progress:
    """One sample, and what is known with it.

    Attributes:
        name: Of the sample.
        target: Wanted position [m], shape (3,).
        fit: With this sample; of a check, without it.
        surprise: This sample against its prediction, or None for the first.
        position: By the fit [m], shape (3,).
        remark: Why the move ended early, or empty.
        tension: [N], shape (n,), or None where they are not measured.
    """

    name: str
    target: Array
    fit: GuideFit
    surprise: Surprise | None
    position: Array
    remark: str
    tension: Array | None


class Guide:
    """Collects samples of one robot.

    Attributes:
        samples: The samples, on the disk.
        fit: Of all samples but the checks, or None before the first.
    """

    def __init__(
        self, robot: Robot, mover: Mover, samples: SampleFile, settings: GuideSettings,
        priors: SelfCalibrationSettings, *, seed: int = 0, at_random: bool = False,
    ) -> None:  # fmt: skip
        """Take a robot whose platform rests at home, or where an earlier run left it.

        Args:
            robot: As in its file.
            mover: Moves and measures.
            samples: Those of an earlier run, or none.
            settings: Of the guide.
            priors: What is known before.
            seed: Of the candidates.
            at_random: Whether to go to random safe positions instead, for comparison.
        """
        self._robot, self._mover, self._settings = robot, mover, settings
        self._seed, self._at_random, self._attempt = seed, at_random, 0
        self.samples = samples
        self.fit: GuideFit | None = None
        self._priors, self._known = priors, nothing_measured(robot, priors)
        self._here = np.array(robot.home_position)
        self._shorter = 1.0

    @property
    def known(self) -> Knowledge:
        """Present knowledge."""
        return self._known

    @property
    def accurate(self) -> bool:
        """True once the exit points are as accurate as wanted."""
        return self._known.exit_distance <= self._settings.accuracy

    @property
    def finished(self) -> bool:
        """True if no sample and no check is missing."""
        count, settings = len(self._collected), self._settings
        enough = count > 0 and (self.accurate or count >= settings.max_samples)
        return enough and len(self._checked) >= settings.checks

    def resume(self) -> GuideFit | None:
        """Find where the platform is, and fit the samples of an earlier run.

        Returns:
            The fit, or None where there are no samples yet.

        Raises:
            CarosacError: The lengths no longer mean what they meant then.
        """
        rest = self._mover.rest()
        fresh = self.samples.reference is None
        if fresh:
            self.samples.start(rest)
        assert self.samples.reference is not None
        measured = self.samples.reference.tension is not None
        self._known = nothing_measured(self._robot, self._priors, tension=measured)
        if fresh:
            return None
        if self.samples.names:
            angles = self.samples.measured()
            place = self._robot.home_position[None]
            for count in range(1, len(angles.samples) + 1):
                self._take(refit(self._known, first(angles, count), place))
                if count < len(angles.samples):
                    ahead = surprises(self._known, first(angles, count + 1), place[-1])[-1]
                    assert self.fit is not None
                    place = np.vstack([self.fit.position, ahead.position])
        (now,) = surprises(self._known, self.samples.one("now", rest), self._here)
        if self.samples.names and not self._taut(rest):
            self._mover.move(self._known, now.position, now.position)
            rest = self._taut_rest(
                "cables are slack", "Pull them taut where the platform is, and start again"
            )
            (now,) = surprises(self._known, self.samples.one("now", rest), self._here)
        if self._taut(rest) and now.chance < FOREIGN_CHANCE:
            raise CarosacError(
                f"{self.samples.path}: the lengths now do not belong to these samples: the spare "
                f"ones are off by {1e3 * now.rms:.3g} mm of line, {1e3 * now.sigma:.3g} mm were "
                "predicted. Has the robot been homed anew, or has a cable slipped? Then begin a "
                "new file"
            )
        self._here = now.position
        return self.fit

    def collect(self) -> Iterator[Progress]:
        """Take samples until the accuracy is reached, yielding each.

        Raises:
            NoSafePosition: There is nowhere to go.
            CarosacError: Cables stay slack.
        """
        if not self.samples.names:
            yield self._first_sample()
        while not self.accurate and len(self._collected) < self._settings.max_samples:
            yield self._sample(str(len(self._collected)), self._next)

    def check(self) -> Iterator[Progress]:
        """Take samples at random positions that count for nothing but the verdict."""
        done = len(self.samples.measured(checks=True).samples) if self._checked else 0
        for k in range(done, self._settings.checks):
            yield self._sample(f"{CHECK_PREFIX}{k + 1}", self._anywhere)

    @property
    def _collected(self) -> list[str]:
        """Names of the samples that are fitted."""
        return [name for name in self.samples.names if not name.startswith(CHECK_PREFIX)]

    @property
    def _checked(self) -> list[str]:
        """Names of the samples that are not."""
        return [name for name in self.samples.names if name.startswith(CHECK_PREFIX)]

    @property
    def checked(self) -> tuple[Surprise, ...]:
        """Checks of this run and of those before, against the present knowledge."""
        if not self._checked:
            return ()
        angles = self.samples.measured(checks=True)
        return tuple(surprises(self._known, angles, self._robot.home_position))

    def _first_sample(self) -> Progress:
        """Tighten the cables at home, and take what is there for home."""
        home = self._robot.home_position
        remark = self._mover.move(self._known, home, home)
        rest = self._taut_rest(
            "the cables are not taut at home", "Tighten them by hand, or raise home"
        )
        self.samples.add(HOME_SAMPLE, rest)
        self._take(refit(self._known, self.samples.measured(), home[None]))
        return self._progress(HOME_SAMPLE, home, None, remark, rest)

    def _sample(self, name: str, choose: Callable[[], Array]) -> Progress:
        """Go where that says, and take a sample wherever the platform ends with taut cables."""
        for self._attempt in range(ATTEMPTS_MAX):
            target = self._mover.while_holding(choose)
            remark = self._mover.move(self._known, self._here, target)
            rest = self._mover.rest()
            (ahead,) = surprises(self._known, self.samples.one(name, rest), target)
            if self._taut(rest) and (not remark or self._is_new(ahead.position)):
                return self._taken(name, target, ahead, remark, rest)
            self._here = ahead.position
            self._shorter *= SHORTER
        raise CarosacError(
            f"{ATTEMPTS_MAX} moves in a row found no new place of rest with taut cables; "
            f"at the last one: {_newtons(rest)}"
        )

    def _taken(
        self, name: str, target: Array, ahead: Surprise, remark: str, rest: Rest
    ) -> Progress:
        """Write a sample to the disk and fit it, unless it is a check."""
        self.samples.add(name, rest)
        self._here, self._shorter = ahead.position, 1.0
        if not name.startswith(CHECK_PREFIX):
            assert self.fit is not None
            place = np.vstack([self.fit.position, ahead.position])
            angles = self.samples.measured()
            self._take(self._mover.while_holding(lambda: refit(self._known, angles, place)))
        return self._progress(name, target, ahead, remark, rest)

    def _take(self, fit: GuideFit) -> None:
        """Take a fit, whose last sample is where the platform is."""
        self.fit, self._known, self._here = fit, fit.known, fit.position[-1]

    def _progress(
        self, name: str, target: Array, ahead: Surprise | None, remark: str, rest: Rest
    ) -> Progress:
        assert self.fit is not None
        return Progress(
            name=name, target=target, fit=self.fit, surprise=ahead, position=self._here,
            remark=remark, tension=rest.tension,
        )  # fmt: skip

    def _is_new(self, position: Array) -> bool:
        """Return whether a place is away from all samples."""
        assert self.fit is not None
        apart = np.linalg.norm(self.fit.position - position, axis=1).min()
        return bool(apart > 0.5 * self._reach().distance * self._settings.first_reach)

    def _taut_rest(self, fault: str, advice: str) -> Rest:
        """Read the sensors at rest; refuse cables that are not taut."""
        rest = self._mover.rest()
        if self._taut(rest):
            return rest
        raise CarosacError(
            f"{fault}: {_newtons(rest)}; allowed: all of them above {self._taut_min.min():.3g} N. "
            f"{advice}"
        )

    def _taut(self, rest: Rest) -> bool:
        """Return whether all cables are taut, as far as that is known."""
        if rest.tension is None:
            return True
        return bool((rest.tension >= self._taut_min).all())

    @property
    def _taut_min(self) -> Array:
        """Tensions from which on a cable counts as taut [N], shape (n,)."""
        low, minimum = operating_tensions(self._robot)[0], self._robot.tension_min
        return np.asarray(minimum + TAUT_SHARE * (low - minimum))

    def _reach(self) -> Reach:
        """Return how far the next move may go: little at first, then as far again."""
        visited = self._robot.home_position[None] if self.fit is None else self.fit.position
        longest = self._known.problem.longest
        extent = float(np.linalg.norm(visited - visited[0], axis=1).max())
        settings = self._settings
        distance = max(settings.first_reach * longest, settings.reach_growth * extent)
        low, minimum = operating_tensions(self._robot)[0], self._robot.tension_min
        kept = self._mover.measures_tension
        return Reach(
            start=self._here,
            visited=visited,
            distance=self._shorter * distance,
            tension_error_max=np.inf if kept else float((low - minimum).min()),
            tentative=kept,
        )

    def _next(self) -> Array:
        """Return the next position: the most informative one, or near what was visited."""
        if self._at_random:
            return self._anywhere()
        best = suggest_positions(self._known, 1, rng=self._rng(), reach=self._reach())
        return np.asarray(best.position[0])

    def _anywhere(self) -> Array:
        """Return a random position that is safe."""
        where, _ = safe_positions(
            self._known, self._rng(), self._reach(), candidates=RANDOM_CANDIDATES, edges=0.0
        )
        return np.asarray(where[0])

    def _rng(self) -> np.random.Generator:
        """Return the source of candidates of this move: the same one after a crash."""
        return np.random.default_rng((self._seed, len(self.samples.names), self._attempt))


def _newtons(rest: Rest) -> str:
    """Return tensions in words."""
    if rest.tension is None:
        return "tensions unknown"
    return f"tensions {', '.join(f'{x:.3g}' for x in rest.tension)} N"
