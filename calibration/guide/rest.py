"""Periods of a driver, and what its sensors say once the platform rests."""

from __future__ import annotations

import numpy as np

from calibration.guide.fit import LINE_SIGMA_BEFORE_M
from calibration.guide.samples import Rest
from calibration.guide.settings import GuideSettings
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.loop.protocols import Driver
from carosac_toolkit.loop.values import Command, Measurement
from carosac_toolkit.safety.guard.checks import STALE_TIME_S

DRIFT_SHARE = 0.2  # of the noise of a line that is expected: drift of a length at rest
TENSION_DRIFT_SHARE = 0.05  # of the mean of a tension: its drift at rest
NOISE_RATIO = 5.0  # of the standard deviation of a drift by noise alone: still rest
WINDOWS_MAX = 12  # sample times after which a platform that drifts is refused


class Stopped(CarosacError):
    """The driver does not go on."""


class NotAtRest(Stopped):
    """The platform does not come to rest."""


class Periods:
    """Periods of a driver: in each a command may be sent, time passes, and sensors are read.

    Attributes:
        measured: The newest measurement.
        measures_tension: True if the driver has load cells.
    """

    def __init__(self, driver: Driver, settings: GuideSettings) -> None:
        """Take a driver that is connected."""
        self._driver, self._settings = driver, settings
        self.measured: Measurement = driver.measure()
        self.measures_tension = self.measured.tension is not None
        self._silent = 0  # periods without new tensions

    @property
    def tension(self) -> Array | None:
        """Newest tensions [N], shape (n,), or None."""
        return None if self.measured.tension is None else self.measured.tension.value[0]

    def one(self, length: Array | None) -> Array | None:
        """Let one period pass.

        Args:
            length: Commanded [m], shape (n,), or None: no command.

        Returns:
            What was really sent [m], shape (n,), or None.

        Raises:
            Stopped: The driver does not go on, or its load cells do not.
        """
        driver, sent = self._driver, None
        try:
            if length is not None:
                command = Command(time=self.measured.time, unstrained_length=length[None])
                sent = np.array(driver.command(command).unstrained_length[0])
            if not driver.wait(self._settings.period):
                raise Stopped(self._why())
            before, self.measured = self.measured, driver.measure()
        except Stopped:
            raise
        except (CarosacError, OSError) as error:
            raise Stopped(self._why(error)) from error
        self._check_tension(before)
        return sent

    def rest(self, length: Array | None) -> Rest:
        """Wait until the platform rests, and return the mean of what the sensors say.

        Args:
            length: Commanded meanwhile [m], shape (n,), or None: no command.

        Raises:
            Stopped: The driver does not go on.
            NotAtRest: It drifts.
        """
        settings = self._settings
        for _ in range(round(settings.settle_time / settings.period)):
            self.one(length)
        for _ in range(WINDOWS_MAX):
            lengths, tensions = [], []
            for _ in range(max(round(settings.sample_time / settings.period), 4)):
                self.one(length)
                lengths.append(self.measured.unstrained_length[0])
                if self.tension is not None:
                    tensions.append(self.tension)
            drift = _excess(lengths, DRIFT_SHARE * LINE_SIGMA_BEFORE_M)
            pull = _excess(tensions, TENSION_DRIFT_SHARE * np.max(tensions, initial=0.0))
            if not drift and not pull:
                return Rest(
                    length=np.mean(lengths, axis=0),
                    tension=np.mean(tensions, axis=0) if tensions else None,
                )
        what = (
            f"a length drifts by {1e3 * drift:.2g} mm"
            if drift
            else (f"a tension drifts by {pull:.2g} N")
        )
        raise NotAtRest(f"the platform does not rest: {what} in {settings.sample_time:g} s")

    def _why(self, error: Exception | None = None) -> str:
        """Return why the driver does not go on."""
        fault, ending = (getattr(self._driver, name, None) for name in ("fault", "ending"))
        if fault is not None:
            return f"fault: {fault}"
        if error is not None:
            return str(error) if isinstance(error, CarosacError) else f"the driver fails: {error}"
        return str(ending or "the driver has stopped")

    def _check_tension(self, before: Measurement) -> None:
        """Require new tensions, if there were some at first."""
        if not self.measures_tension:
            return
        now, last = self.measured.tension, before.tension
        if now is None or last is None:
            raise Stopped("the driver no longer measures tensions. Look at the load cells")
        self._silent = 0 if now.time[0] > last.time[0] else self._silent + 1
        silent = self._silent * self._settings.period
        if self._silent > 1 and silent > STALE_TIME_S:
            raise Stopped(
                f"no new tensions for {silent:.2f} s; allowed: {STALE_TIME_S:g} s. Look at the "
                "load cells"
            )


def _excess(readings: list[Array], allowed: float) -> float:
    """Return the largest drift over readings (m, n) where it is no noise, or 0."""
    if not readings:
        return 0.0
    halves = np.array_split(np.array(readings), 2)
    drift = 2.0 * np.abs(halves[1].mean(axis=0) - halves[0].mean(axis=0))
    noise = 2.0 * np.sqrt(sum(half.var(axis=0) / len(half) for half in halves))
    largest = np.where(drift > np.maximum(allowed, NOISE_RATIO * noise), drift, 0.0).max()
    return float(largest)
