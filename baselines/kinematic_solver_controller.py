"""The kinematic solver as a controller: catenary inverse kinematics of the reference."""

from __future__ import annotations

from baselines.lookahead import LookaheadController
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.loop.values import Belief, Command, Reference
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.robot.robot import Robot


class UnreachableReference(CarosacError):
    """A reference position at which the robot cannot rest within its tension limits."""


def rest_at(robot: Robot, position: Array, controller: str) -> statics.Equilibrium:
    """Solve for rest at positions (B, 3) [m], for a controller named in the error.

    Raises:
        UnreachableReference: There is no rest within the tension limits at one of them.
    """
    rest = statics.inverse_kinematics(robot, position)
    if not rest.converged.all():
        row = int((~rest.converged).argmax())
        reason = statics.STATUS_REASONS[rest.status[row]]
        raise UnreachableReference(f"{controller}: position {position[row].round(4)} m: {reason}")
    return rest


class KinematicSolverController(LookaheadController):
    """Sends the lengths at which the platform rests at the reference: sag, tilt and stretch count.

    With six cables or more the orientation is held at home; with fewer it follows from statics.
    """

    def command(self, belief: Belief, reference: Reference) -> Command:
        """Return the lengths of rest at the pose ahead.

        Raises:
            UnreachableReference: There is no rest within the tension limits there.
        """
        position, _ = self._ahead.aim(belief, reference)
        rest = rest_at(self._robot, position, "kinematic_solver")
        return Command(time=belief.time, unstrained_length=rest.unstrained_length)
