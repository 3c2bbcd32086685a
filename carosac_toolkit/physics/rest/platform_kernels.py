"""The platform on its cables: wrench, stiffness and small dense algebra, in float64 Warp."""

import warp as wp

from carosac_toolkit.physics.cable.catenary_kernels import (
    DIVISION_FLOOR,
    HALF,
    ONE,
    ZERO,
    HungCable,
    mat66d,
    vec6d,
)
from carosac_toolkit.physics.device_kernels import StaticBody

wp.set_module_options({"enable_backward": False, "max_unroll": 1})


@wp.struct
class WrenchBalance:
    """Wrench on the platform at its origin, and minus its derivative."""

    wrench: vec6d  # [N, N m]
    stiffness: mat66d  # -d wrench / d (translation, rotation vector), in W


@wp.struct
class Poses:
    """Poses of a batch, (B,), and their cables, (B, n); arrays that a kernel skips stay empty."""

    position: wp.array(dtype=wp.vec3d)  # in W [m]
    rotation: wp.array(dtype=wp.mat33d)  # from P to W: where to begin, then the answer
    unstrained_length: wp.array2d(dtype=wp.float64)  # [m]
    tension: wp.array2d(dtype=wp.float64)  # at the platform [N]
    q: wp.array2d(dtype=wp.vec3d)  # tension vector at the exit [N]
    inverse: wp.array2d(dtype=wp.mat33d)  # (d closure / d q)^-1 [N/m]
    stiffness: wp.array(dtype=mat66d)
    residual: wp.array(dtype=wp.float64)  # norm of the wrench [N]
    closure: wp.array(dtype=wp.float64)  # largest of a cable [m]
    status: wp.array(dtype=int)
    stable: wp.array(dtype=int)
    steps: wp.array(dtype=int)
    lower: wp.array2d(dtype=wp.float64)  # limits of the tensions [N]
    upper: wp.array2d(dtype=wp.float64)
    middle: wp.array2d(dtype=wp.float64)  # tensions to stay close to [N]
    softness: wp.array2d(dtype=wp.float64)  # scratch of the choice of tensions, as in `Cost`
    reference: wp.array2d(dtype=wp.float64)
    scale: wp.array2d(dtype=wp.float64)
    iterate: wp.array2d(dtype=wp.float64)
    wanted: wp.array2d(dtype=wp.float64)  # tensions after a step [N], or unknowns (B, unknowns)
    column: wp.array2d(dtype=vec6d)  # d scaled wrench / d unknown, (B, unknowns)
    twist: wp.array2d(dtype=wp.vec3d)  # dual gradient of each cable
    bound: wp.array2d(dtype=int)  # 1: held at the lower limit, 2: at the upper one
    low: wp.array2d(dtype=wp.float64)  # multipliers of the lower limits
    high: wp.array2d(dtype=wp.float64)
    kept: wp.array2d(dtype=wp.float64)  # tensions before a step [N]
    margin: wp.array(dtype=wp.float64)  # [N]
    gap: wp.array(dtype=wp.float64)  # of the margin [N]


@wp.func
def cross_matrix(a: wp.vec3d) -> wp.mat33d:
    """Return the matrix [a]x of a x b = [a]x b."""
    return wp.mat33d(ZERO, -a[2], a[1], a[2], ZERO, -a[0], -a[1], a[0], ZERO)


@wp.func
def rotation_of(v: wp.vec3d) -> wp.mat33d:
    """Return the rotation matrix of a rotation vector (Rodrigues)."""
    angle = wp.length(v)
    s = ONE - angle * angle / wp.float64(6.0)
    c = HALF - angle * angle / wp.float64(24.0)
    if angle > wp.float64(1.0e-4):
        s = wp.sin(angle) / angle
        c = (ONE - wp.cos(angle)) / (angle * angle)
    k = cross_matrix(v)
    return wp.identity(n=3, dtype=wp.float64) + s * k + c * (k * k)


@wp.func
def orthonormal(r: wp.mat33d) -> wp.mat33d:
    """Remove the rounding that products of rotations collect (Newton step of the polar form)."""
    return wp.float64(1.5) * r - HALF * (r * wp.transpose(r) * r)


@wp.func
def lever_terms(arm: wp.vec3d, force: wp.vec3d, k: wp.mat33d):
    """Return the moment of a force at a lever arm, and the parts of its rotational stiffness.

    With k = -d force / d anchor and X = [arm]x these are kX and XkX, from the motion of the anchor
    point, and the derivative of the moment as the arm of a constant force turns.
    """
    x = cross_matrix(arm)
    kx = k * x
    turn = wp.outer(arm, force) - wp.dot(arm, force) * wp.identity(n=3, dtype=wp.float64)
    return wp.cross(arm, force), kx, x * kx, turn


@wp.func
def add_lever(stiffness: mat66d, wrench: vec6d, arm: wp.vec3d, force: wp.vec3d,
              k: wp.mat33d) -> WrenchBalance:  # fmt: skip
    """Add a force with an anchor stiffness k = -d force / d anchor at a lever arm."""
    moment, kx, xkx, turn = lever_terms(arm, force, k)
    turn = HALF * (turn + wp.transpose(turn))  # at equilibrium the whole of it, summed over forces
    out = WrenchBalance()
    out.wrench = wrench + vec6d(force[0], force[1], force[2], moment[0], moment[1], moment[2])
    s = stiffness
    for i in range(3):
        for j in range(3):
            s[i, j] = s[i, j] + k[i, j]
            s[i, j + 3] = s[i, j + 3] - kx[i, j]
            s[j + 3, i] = s[j + 3, i] - kx[i, j]
            s[i + 3, j + 3] = s[i + 3, j + 3] - HALF * (xkx[i, j] + xkx[j, i]) - turn[i, j]
    out.stiffness = s
    return out


@wp.func
def gravity_balance(body: StaticBody, rotation: wp.mat33d) -> WrenchBalance:
    """Return the weight of the platform about its origin."""
    zero = WrenchBalance()
    return add_lever(
        zero.stiffness,
        zero.wrench,
        rotation * body.center_of_mass,
        wp.vec3d(ZERO, ZERO, -body.weight),
        wp.mat33d(),
    )


@wp.func
def cable_stiffness(state: HungCable, inverse: wp.mat33d) -> wp.mat33d:
    """Return -d force / d anchor at constant unstrained length [N/m], symmetric."""
    k = state.force_q * inverse
    return HALF * (k + wp.transpose(k))


@wp.struct
class Factor:
    """Lower-triangular L and pivots D of a symmetric matrix, packed in one."""

    ldl: mat66d
    pivot_min: wp.float64


@wp.func
def factorise(a: mat66d) -> Factor:
    """Factorise a symmetric 6x6 matrix as LDL^T; pivot_min <= 0: not positive definite."""
    m = a
    least = m[0, 0]
    for j in range(6):
        d = m[j, j]
        for k in range(j):
            d -= m[j, k] * m[j, k] * m[k, k]
        m[j, j] = d
        least = wp.min(least, d)
        safe = d
        if wp.abs(d) < wp.float64(1.0e-300):
            safe = wp.float64(1.0e-300)
        for i in range(j + 1, 6):
            s = m[i, j]
            for k in range(j):
                s -= m[i, k] * m[j, k] * m[k, k]
            m[i, j] = s / safe
    out = Factor()
    out.ldl = m
    out.pivot_min = least
    return out


@wp.func
def solve_factored(m: mat66d, b: vec6d) -> vec6d:
    """Solve with the packed LDL^T of `factorise`."""
    x = b
    for i in range(6):
        for k in range(i):
            x[i] = x[i] - m[i, k] * x[k]
    for i in range(6):
        x[i] = x[i] / m[i, i]
    for i in range(6):
        j = 5 - i
        for k in range(j + 1, 6):
            x[j] = x[j] - m[k, j] * x[k]
    return x


@wp.func
def scaled_norm(wrench: vec6d, arm: wp.float64) -> wp.float64:
    """Return the norm of a wrench [N], moments divided by the typical lever arm."""
    f = wp.vec3d(wrench[0], wrench[1], wrench[2])
    t = wp.vec3d(wrench[3], wrench[4], wrench[5]) / arm
    return wp.sqrt(wp.dot(f, f) + wp.dot(t, t))


@wp.func
def regularised(a: mat66d, mu: wp.float64, arm: wp.float64) -> mat66d:
    """Add mu [N/m] to the translations and mu arm^2 to the rotations."""
    m = a
    for i in range(3):
        m[i, i] = m[i, i] + mu
        m[i + 3, i + 3] = m[i + 3, i + 3] + mu * arm * arm
    return m


@wp.struct
class DescentStep:
    """A step of the platform towards rest."""

    step: vec6d  # translation [m], rotation vector [rad], in W
    pivot_min: wp.float64  # least pivot of the stiffness: positive where it is positive definite


@wp.func
def descent_step(
    total: WrenchBalance, body: StaticBody, reach: wp.float64, turn: wp.float64
) -> DescentStep:
    """Return a Newton step down the energy, regularised and limited in size.

    Args:
        total: Wrench and stiffness at the pose.
        body: The platform.
        reach: Longest translation, as a share of the typical cable length.
        turn: Largest rotation [rad].
    """
    f = factorise(total.stiffness)
    out = DescentStep()
    out.pivot_min = f.pivot_min
    soft = wp.float64(1.0e-3) * body.weight / body.size
    mu = wp.float64(0.0)
    tries = int(0)
    while f.pivot_min <= wp.float64(1.0e-3) * soft and tries < 40:
        mu = wp.max(mu * wp.float64(4.0), soft)
        f = factorise(regularised(total.stiffness, mu, body.arm))
        tries += 1
    step = solve_factored(f.ldl, total.wrench)
    move = wp.sqrt(step[0] * step[0] + step[1] * step[1] + step[2] * step[2])
    angle = wp.sqrt(step[3] * step[3] + step[4] * step[4] + step[5] * step[5])
    limit = wp.min(reach * body.size / (move + DIVISION_FLOOR), turn / (angle + DIVISION_FLOOR))
    out.step = wp.min(ONE, limit) * step
    return out


@wp.func
def translation(step: vec6d) -> wp.vec3d:
    """Return the linear part."""
    return wp.vec3d(step[0], step[1], step[2])


@wp.func
def turned(rotation: wp.mat33d, step: vec6d) -> wp.mat33d:
    """Return the rotation after the angular part of a step, orthonormal to rounding."""
    return orthonormal(rotation_of(wp.vec3d(step[3], step[4], step[5])) * rotation)
