"""The kinematic solver KS: the equilibrium of platform and sagging cables at the measured lengths.

References:
    Allak et al., *Kinematics-Inertial Fusion for Localization of a 4-Cable Underactuated Suspended
    Robot Considering Cable Sag*, IROS 2022.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from baselines.solve_record import SolveRecord, belief_at_home
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.loop.values import Belief, Command, Measurement, Pose
from carosac_toolkit.physics.rest.statics import Equilibrium, forward_kinematics
from carosac_toolkit.robot.robot import Robot

Seed = Literal["belief", "cold", "pose"]


@dataclass(frozen=True, kw_only=True)
class KinematicSolverSettings:
    """Settings of `KinematicSolver`.

    Attributes:
        seed: Where each solve starts: at the last solution (``"belief"``), nowhere in particular
            (``"cold"``), or at a pose estimate from ``Measurement.pose`` (``"pose"``), as in the
            IROS 2022 paper.
        restart: Solve again without a seed where the seeded solve fails; restarts are counted.
    """

    seed: Seed = "belief"
    restart: bool = True

    def __post_init__(self) -> None:
        """Refuse an unknown seed."""
        if self.seed not in get_args(Seed):
            raise InvalidField("seed", repr(self.seed), f"one of {list(get_args(Seed))}")


class KinematicSolver:
    """Catenary forward kinematics at every measurement; no motion, no noise model.

    A pose counts as found where the solve converged to a stable equilibrium. Elsewhere the belief
    keeps the last good pose, and ``belief.memory``, a `SolveRecord`, says so and counts it.
    """

    Settings: ClassVar = KinematicSolverSettings
    batched: ClassVar = True

    def __init__(self, robot: Robot, settings: KinematicSolverSettings) -> None:
        self._robot = robot
        self._settings = settings

    @classmethod
    def build(
        cls, robot: Robot, settings: KinematicSolverSettings | None = None, *, seed: int = 0
    ) -> KinematicSolver:
        """Make one for the nominal robot; it draws no random numbers, so `seed` has no effect."""
        return cls(robot, settings or KinematicSolverSettings())

    def reset(self, measurement: Measurement) -> Belief:
        """Solve the first lengths, without a guess unless poses are the seed.

        Raises:
            InvalidField: Poses are the seed and the first measurement has none.
        """
        if self._settings.seed == "pose" and measurement.pose is None:
            raise InvalidField(
                "measurement.pose", None, "a pose, since the solver's seed is 'pose'"
            )
        home = belief_at_home(self._robot, measurement)
        return self._solve(home, measurement, measurement.pose if self._by_pose else None)

    def update(self, belief: Belief, command: Command, measurement: Measurement) -> Belief:
        """Solve the new lengths; the command is not used.

        Where poses are the seed and this measurement has none, the solve starts at the last
        solution instead, which ``belief.memory.unseeded`` counts.
        """
        if self._by_pose and measurement.pose is not None:
            return self._solve(belief, measurement, measurement.pose)
        if self._settings.seed == "cold":
            return self._solve(belief, measurement, None)
        record: SolveRecord = belief.memory
        guess = record.solution
        if guess is None:
            guess = Pose(position=belief.position, rotation=belief.rotation)
        return self._solve(belief, measurement, guess)

    @property
    def _by_pose(self) -> bool:
        return self._settings.seed == "pose"

    def _solve(
        self, belief: Belief, measurement: Measurement, guess: Equilibrium | Pose | None
    ) -> Belief:
        """Solve from a guess, again without one where that fails, and keep what is good."""
        lengths = measurement.unstrained_length
        rest = forward_kinematics(self._robot, lengths, guess=guess)
        again = ~_is_good(rest) & (self._settings.restart and guess is not None)
        result = _pose_and_forces(rest)
        if again.any():
            second = _pose_and_forces(forward_kinematics(self._robot, lengths[again]))
            result = {name: _put(result[name], again, second[name]) for name in result}
        good: NDArray[np.bool_] = result["good"]
        record: SolveRecord = belief.memory
        return Belief(
            time=measurement.time,
            position=np.where(good[:, None], result["position"], belief.position),
            rotation=np.where(good[:, None, None], result["rotation"], belief.rotation),
            tension=_keep_tension(good, result["tension"], belief.tension),
            converged=good,
            memory=replace(
                record,
                converged=good,
                residual=result["residual"],
                updates=record.updates + 1,
                failures=record.failures + ~good,
                restarts=record.restarts + again,
                unseeded=record.unseeded + int(self._by_pose and measurement.pose is None),
                solution=rest if good.all() and not again.any() else None,
            ),
        )


def _pose_and_forces(rest: Equilibrium) -> dict[str, NDArray[Any]]:
    """Return the parts of a solution that a belief takes, row by row."""
    return {
        "position": rest.position,
        "rotation": rest.rotation,
        "tension": rest.tension,
        "residual": rest.residual,
        "good": _is_good(rest),
    }


def _is_good(rest: Equilibrium) -> NDArray[np.bool_]:
    """Return where a solution is a pose at which the platform can rest."""
    return np.asarray(rest.converged & rest.stable)


def _put(old: NDArray[Any], where: NDArray[np.bool_], new: NDArray[Any]) -> NDArray[Any]:
    """Return a copy of `old` with the rows of `where` replaced."""
    result = np.array(old)
    result[where] = new
    return result


def _keep_tension(good: NDArray[np.bool_], new: Array, old: Array | None) -> Array | None:
    """Return new tensions where they are good, else the last good ones; None without any."""
    if good.all():
        return new
    return None if old is None else np.where(good[:, None], new, old)
