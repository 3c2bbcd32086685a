"""The kinematic solver as a controller: catenary inverse kinematics of the reference."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from baselines.lookahead import LookaheadController, LookaheadSettings
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.loop.values import Belief, Command, Reference
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.rest.tension_problem import DistributionName, check_distribution
from carosac_toolkit.robot.robot import Robot


class UnreachableReference(CarosacError):
    """A reference position at which the robot cannot rest within its tension limits."""


@dataclass(frozen=True, kw_only=True)
class KinematicSolverControllerSettings(LookaheadSettings):
    """Settings of `KinematicSolverController`.

    Attributes:
        distribution: Which tensions a robot of more than six cables rests with, as in
            `tension_distribution`; fewer than six have no choice.
    """

    distribution: DistributionName = "least_squares"

    def __post_init__(self) -> None:
        """Refuse numbers that make no sense and an unknown distribution."""
        super().__post_init__()
        check_distribution(self.distribution)


def rest_at(
    robot: Robot,
    position: Array,
    controller: str,
    distribution: DistributionName = "least_squares",
) -> statics.Equilibrium:
    """Solve for rest at positions (B, 3) [m], for a controller named in the error.

    Raises:
        UnreachableReference: There is no rest within the tension limits at one of them.
    """
    rest = statics.inverse_kinematics(robot, position, distribution=distribution)
    if not rest.converged.all():
        row = int((~rest.converged).argmax())
        reason = statics.STATUS_REASONS[rest.status[row]]
        raise UnreachableReference(f"{controller}: position {position[row].round(4)} m: {reason}")
    return rest


class KinematicSolverController(LookaheadController):
    """Sends the lengths at which the platform rests at the reference: sag, tilt and stretch count.

    With six cables or more the orientation is held at home; with fewer it follows from statics.
    """

    Settings: ClassVar = KinematicSolverControllerSettings

    def __init__(self, robot: Robot, settings: LookaheadSettings) -> None:
        super().__init__(robot, settings)
        usual = KinematicSolverControllerSettings.distribution
        self._distribution: DistributionName = getattr(settings, "distribution", usual)
        check_distribution(self._distribution, robot.n)

    def command(self, belief: Belief, reference: Reference) -> Command:
        """Return the equilibrium lengths at the pose ahead.

        Raises:
            UnreachableReference: There is no rest within the tension limits there.
        """
        position, _ = self._ahead.aim(belief, reference)
        rest = rest_at(self._robot, position, "kinematic_solver", self._distribution)
        return Command(time=belief.time, unstrained_length=rest.unstrained_length)
