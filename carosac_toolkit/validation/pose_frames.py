"""Frames of measured poses: another world frame, or another frame on the platform.

The poses at which the platform would rest on the lengths are compared with the measured ones. Sway
averages out, and what a calibration changes is small beside a turned frame. With the rotation Q
and the origin t of the frame of the poses in W, and the rotation C of the platform frame P in the
tracked body, a platform at rest shows p_W = Q p + t and R_W = Q R C.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from carosac_toolkit.base.arrays import Array, evenly
from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.loop.values import Pose
from carosac_toolkit.physics.rest.statics import forward_kinematics
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.validation.first_motion import SIX_CABLES

RESTS_MAX = 300  # poses of rest that are compared, evenly spread
RESTS_MIN = 4
WORLD_TURN_MIN_RAD = 0.1  # [rad]: a smaller turn is a matter of calibration
YAW_MIN_RAD = 0.1  # [rad] of the body about the vertical
TILT_MIN_RAD = 0.25  # [rad] of the body: the centre of mass may tilt a platform by as much
SAME_SPREAD_MIN_RAD = 0.02  # [rad] of attitudes of rest: noise of lengths turns them by less
MIRROR_MISFIT_MAX = 0.3  # of the spread of positions along each axis
TURN_WITHOUT_ZEROS_MIN_RAD = 0.35  # [rad] of the body, where zeros of lengths may tilt it
SHIFT_MIN = Scaled(0.1, "m", most=0.1)  # a smaller shift is a matter of calibration
SHIFT_COST_MIN = 14.16  # chi squared of three freedoms, at the chance of three sigmas
SHIFT_PARTS = 5  # of a recording, whose means tell a shift
MISFIT_SHARE = 0.05  # of the least shift and turn: misfits that nothing need explain
WIDTH_MIN = Scaled(0.03, "m")  # RMS across the main direction: less is a line, free to turn
WIDTH_OVER_MISFIT_MIN = 5.0  # of what turned positions leave
LEFT_SHARE_MAX = 0.5  # of the misfit that another frame may leave, to be named
AXIS_COSINE_MIN = 0.98  # of a turn about an axis that goes by the axis's name
RestDoubt = Callable[[NDArray[np.intp]], Array]  # of some samples, see `find_frames`


@dataclass(frozen=True, kw_only=True, eq=False)
class PoseFrames:
    """Frames that measured poses seem to be in.

    Attributes:
        world_turn: Rotation from the frame of the poses to W, shape (3, 3); identity where it is
            W, or not told.
        shift: What is to be added to turned positions [m], shape (3,); zero where they fit.
        body_turn: Rotation from P to the tracked body, shape (3, 3); identity where it is P.
        inverted: True if the inverse orientations fit: those from W to P.
        backward: True if the positions fit as well once the whole poses are inverted.
        axes: Names of the measured axes, with their signs, that fit as x, y and z of W, where this
            mirrors space: axes were exchanged, or a sign; empty where it does not.
        unmeasured: True if orientations are all the same, though the platform must have turned.
    """

    world_turn: Array
    shift: Array
    body_turn: Array
    inverted: bool = False
    backward: bool = False
    axes: tuple[str, ...] = ()
    unmeasured: bool = False

    @property
    def turned(self) -> bool:
        """True if orientations or axes are not those of the platform in W."""
        other = self.inverted or self.unmeasured or bool(self.axes)
        return other or _angle(self.world_turn) > 0.0 or _angle(self.body_turn) > 0.0

    @property
    def only_moved(self) -> bool:
        """True if a shift is all that is told."""
        return bool(self.shift.any()) and not self.turned

    def sentences(self, robot: Robot) -> Iterator[str]:
        """Name the frames that are not those of the robot."""
        if self.backward:
            yield "Poses fit once inverted: they are those of W in the platform frame."
        elif self.inverted:
            yield (
                "Orientations fit once inverted: they are to be those from the platform frame to "
                "W; conjugate the quaternions (w, -x, -y, -z)."
            )
        if self.unmeasured:
            yield (
                "The orientation is the same at all times, though the platform turns as its cables "
                "are wound: it was not measured."
            )
        if self.axes:
            yield (
                f"Positions fit if ({', '.join(self.axes)}) of the measured ones are x, y and z of "
                f"W of robot {robot.name}: axes are exchanged, or a sign."
            )
        world = Rotation.from_matrix(self.world_turn).as_rotvec()
        body = Rotation.from_matrix(self.body_turn).as_rotvec()
        moved, shifted = _components(self.shift), bool(self.shift.any())
        if world.any():
            yield (
                f"The frame of the poses is turned against W of robot {robot.name}: they fit once "
                f"turned by {_said(world)} of W"
                + (f", then moved by {moved} m." if shifted else ".")
            )
        elif shifted:
            yield (
                f"Positions are {np.linalg.norm(self.shift):.2f} m from where the lengths hold the "
                f"platform: they fit once moved by {moved} m in W. Is the tracked point the origin "
                "of the platform frame, is the frame of the poses W, and are the zeros of the "
                "lengths right ('carosac calibrate lengths' finds them)?"
            )
        if body.any():
            yield (
                f"The tracked body is not the platform frame of robot {robot.name}: orientations "
                f"fit once turned by {_said(body)} of the tracked body."
            )


def find_frames(
    robot: Robot,
    length: Array,
    pose: Pose,
    *,
    zeros_known: bool = True,
    doubt: RestDoubt | None = None,
) -> PoseFrames | None:
    """Estimate the frames of measured poses from poses of rest on the lengths.

    Args:
        robot: Robot description, n cables.
        length: Unstrained [m], shape (S, n).
        pose: Measured at the same times.
        zeros_known: True if lengths are known but for what a calibration changes. If not, only
            larger turns of the body are looked for, where the positions fit.
        doubt: Returns for some of the samples (K,) by how much poses of rest may be off, as
            positions [m] in W and turns [rad] in axes of the platform, by one sigma of each of k
            things that are not known of the robot, (K, 6, k); asked only if positions seem moved.
            None: the robot is known but for what a calibration changes.

    Returns:
        Frames, those of the robot where another one would not explain over half of the misfit, or
        where what is not known of the robot may explain it;
        None where the robot cannot rest on the lengths.
    """
    count = len(length)
    some = evenly(count, RESTS_MAX)
    length = length[some]
    if not len(length) or (length <= 0.0).any():
        return None
    rest = forward_kinematics(robot, length)
    good = rest.converged & rest.stable
    if good.sum() < min(RESTS_MIN, len(length)):
        return None
    position, rotation = pose.position[some][good], pose.rotation[some][good]
    rests, attitudes = rest.position[good], rest.rotation[good]
    ratios = Scales(robot).ratios
    inverted = _explained_by_inverse(rotation, attitudes)
    unmeasured = robot.n < SIX_CABLES and _same(rotation, attitudes)
    backward = False
    if inverted:
        rotation = rotation.swapaxes(1, 2)
        other = -np.einsum("sij,sj->si", rotation, position)
        missed = [float(np.linalg.norm(each - rests, axis=1).mean()) for each in (position, other)]
        backward = missed[1] < LEFT_SHARE_MAX * missed[0]
        position = other if backward else position
    axes = _mirroring_axes(position, rests)
    if axes:
        return PoseFrames(world_turn=np.eye(3), shift=np.zeros(3), body_turn=np.eye(3), axes=axes)
    by_attitudes = _mean_rotation(attitudes @ rotation.swapaxes(1, 2))
    world = _turn_of_world(position, rests, by_attitudes, WIDTH_MIN.of(ratios))
    body = _mean_rotation((world @ rotation).swapaxes(1, 2) @ attitudes)
    missing = rests - position @ world.T
    shift = missing.mean(axis=0)
    least = SHIFT_MIN.of(ratios)
    scatter = float(np.sqrt(((missing - shift) ** 2).sum(axis=1).mean()))
    zeros_right = zeros_known or float(np.linalg.norm(shift)) < least
    if not zeros_right or not _explains_attitudes(
        world @ rotation, attitudes, body, zeros_known=zeros_known
    ):
        body = np.eye(3)
    far = float(np.linalg.norm(shift)) > max(least, scatter)
    if far and doubt is not None:
        turned = Rotation.from_matrix((world @ rotation @ body).swapaxes(1, 2) @ attitudes)
        misfit = np.hstack([missing, turned.as_rotvec()])
        compared = np.arange(count)[some][good]
        far = _shows_shift(misfit, lambda rows: doubt(compared[rows]), least)
    if not far:
        shift = np.zeros(3)
    return PoseFrames(
        world_turn=world,
        shift=shift,
        body_turn=body,
        inverted=inverted,
        backward=backward,
        unmeasured=unmeasured,
    )


def _mirroring_axes(position: Array, rests: Array) -> tuple[str, ...]:
    """Return which measured axes fit x, y and z of W, where these mirror space; else nothing.

    Positions near a plane fit as well mirrored at it: they must spread in all directions. So may
    a platform that swings against the way of its rests, but not by as much.
    """
    measured, wanted = position - position.mean(axis=0), rests - rests.mean(axis=0)
    left, _, right = np.linalg.svd(wanted.T @ measured)
    mirror = left @ right
    if np.linalg.det(mirror) > 0.0 or np.abs(mirror).max(axis=1).min() < AXIS_COSINE_MIN:
        return ()
    turn = left @ np.diag([1.0, 1.0, -1.0]) @ right
    proper, mirrored = (
        float(np.sqrt(((wanted - measured @ each.T) ** 2).sum(axis=1).mean()))
        for each in (turn, mirror)
    )
    spread = float(wanted.std(axis=0).min())
    if mirrored >= min(LEFT_SHARE_MAX * proper, MIRROR_MISFIT_MAX * spread):
        return ()
    main = np.abs(mirror).argmax(axis=1)
    signs = np.sign(mirror[np.arange(3), main])
    return tuple(
        f"{'-' if sign < 0.0 else ''}{'xyz'[k]}" for k, sign in zip(main, signs, strict=True)
    )


def _explained_by_inverse(rotation: Array, attitudes: Array) -> bool:
    """Return whether inverse orientations fit far better than those that were measured."""
    before, after = (
        float(np.sqrt((Rotation.from_matrix(each @ attitudes).magnitude() ** 2).mean()))
        for each in (rotation.swapaxes(1, 2), rotation)
    )
    return before > TILT_MIN_RAD and after < LEFT_SHARE_MAX * before


def _same(rotation: Array, attitudes: Array) -> bool:
    """Return whether orientations are all the same, where the attitudes of rest differ.

    Six cables and more hold an attitude, and errors of lengths turn it.
    """
    if len(rotation) < 2 or np.ptp(rotation, axis=0).max() > 0.0:
        return False
    mean = _mean_rotation(attitudes)
    spread = Rotation.from_matrix(mean.T @ attitudes).magnitude()
    return bool(np.sqrt((spread**2).mean()) > SAME_SPREAD_MIN_RAD)


def _shows_shift(misfit: Array, doubt: RestDoubt, least: float) -> bool:
    """Return whether moved positions explain a misfit better than what is not known of the robot.

    Means of parts of a recording are compared, each as uncertain as what it is a mean of scatters.
    A platform that swings is not where it would rest, and not about it either, where it swings far.

    Args:
        misfit: Of positions and turns, shape (S, 6).
        doubt: Of rests, as of `find_frames`.
        least: Shift that counts [m].
    """
    parts = np.array_split(np.arange(len(misfit)), min(SHIFT_PARTS, len(misfit)))
    mean = np.concatenate([misfit[rows].mean(axis=0) for rows in parts])
    noise = np.mean([misfit[rows].var(axis=0) for rows in parts], axis=0)
    noise += np.repeat([MISFIT_SHARE * least, MISFIT_SHARE * WORLD_TURN_MIN_RAD], 3) ** 2
    moved = doubt(np.array([rows[len(rows) // 2] for rows in parts]))
    slopes = moved.reshape(len(mean), -1)
    known = slopes @ slopes.T + np.diag(np.tile(noise, len(parts)))
    shifts = np.tile(np.eye(6, 3), (len(parts), 1))
    pull = shifts.T @ np.linalg.solve(known, mean)
    told = shifts.T @ np.linalg.solve(known, shifts)
    return bool(pull @ np.linalg.solve(told, pull) > SHIFT_COST_MIN)


def _turn_of_world(position: Array, rests: Array, by_attitudes: Array, width_min: float) -> Array:
    """Return the rotation Q about which rests are Q position + t, or identity (3, 3).

    Positions along a line tell no turn about it; there the turn of the attitudes is tried.
    """
    measured, wanted = position - position.mean(axis=0), rests - rests.mean(axis=0)
    turn = by_attitudes
    if len(measured) > 1:
        width = float(np.linalg.svd(measured, compute_uv=False)[1]) / np.sqrt(len(measured))
        if width > width_min:
            aligned = Rotation.align_vectors(wanted, measured)[0].as_matrix()
            misfit = float(np.sqrt(((wanted - measured @ aligned.T) ** 2).sum(axis=1).mean()))
            if width > WIDTH_OVER_MISFIT_MIN * misfit:
                turn = aligned
    before, after = (float(((wanted - measured @ t.T) ** 2).sum()) for t in (np.eye(3), turn))
    explains = after < LEFT_SHARE_MAX**2 * before
    return turn if explains and _angle(turn) > WORLD_TURN_MIN_RAD else np.eye(3)


def _explains_attitudes(
    rotation: Array, attitudes: Array, body: Array, *, zeros_known: bool
) -> bool:
    """Return whether a turn of the body is large, and explains most of the misfit."""
    turn = _mean_rotation(rotation) @ Rotation.from_matrix(body).as_rotvec()
    yaw, tilt = abs(float(turn[2])), float(np.hypot(turn[0], turn[1]))
    if zeros_known and yaw < YAW_MIN_RAD and tilt < TILT_MIN_RAD:
        return False
    if not zeros_known and np.hypot(yaw, tilt) < TURN_WITHOUT_ZEROS_MIN_RAD:
        return False
    before, after = (
        float(Rotation.from_matrix((rotation @ turn).swapaxes(1, 2) @ attitudes).magnitude().mean())
        for turn in (np.eye(3), body)
    )
    return after < LEFT_SHARE_MAX * before


def _mean_rotation(rotation: Array) -> Array:
    """Return the mean of rotations (S, 3, 3)."""
    return np.asarray(Rotation.from_matrix(rotation).mean().as_matrix())


def _angle(turn: Array) -> float:
    return float(Rotation.from_matrix(turn).magnitude())


def _said(vector: Array) -> str:
    """Describe a rotation vector [rad] by angle and axis."""
    angle = float(np.linalg.norm(vector))
    axis = vector / angle
    main = int(np.argmax(np.abs(axis)))
    if abs(axis[main]) >= AXIS_COSINE_MIN:
        return f"{np.degrees(angle) * np.sign(axis[main]):.0f} degrees about {'xyz'[main]}"
    return f"{np.degrees(angle):.0f} degrees about {_components(axis)}"


def _components(vector: Array) -> str:
    """Write the components of a vector."""
    return f"({', '.join(f'{round(value, 2) + 0.0:.2f}' for value in vector)})"  # no -0.00
