"""The kinematic solver as a controller: catenary inverse kinematics of the reference."""

from __future__ import annotations

from baselines.lookahead import LookaheadController
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.loop.values import Belief, Command, Reference
from carosac_toolkit.physics.rest import statics


class UnreachableReference(CarosacError):
    """A reference position at which the robot cannot rest within its tension limits."""


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
        rest = statics.inverse_kinematics(self._robot, position)
        if not rest.converged.all():
            row = int((~rest.converged).argmax())
            raise UnreachableReference(
                f"kinematic_solver: position {position[row].round(4)} m: "
                f"{statics.REASONS[rest.status[row]]}"
            )
        return Command(time=belief.time, unstrained_length=rest.unstrained_length)
