"""Warp kernels of straight, massless cables that may wrap a pulley; float64, one thread a pose."""

import warp as wp

from carosac_toolkit.physics.device_kernels import Cable

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

f64 = wp.float64
vec3 = wp.vec3d
mat33 = wp.mat33d

PI = wp.constant(wp.float64(3.141592653589793))
DAMPING_START = wp.constant(wp.float64(1.0e-2))  # first damping, per cable, once a step is refused
DAMPING_MAX = wp.constant(wp.float64(1.0e12))  # no step can be accepted any more


@wp.func
def perpendicular(axis: vec3):
    """Return any unit vector at right angles to a unit vector."""
    other = vec3(f64(1.0), f64(0.0), f64(0.0))
    if wp.abs(axis[0]) > f64(0.7):
        other = vec3(f64(0.0), f64(1.0), f64(0.0))
    return wp.normalize(wp.cross(axis, other))


@wp.func
def pulley_cable(relative: vec3, radius: f64, axis: vec3):
    """Return the results of `straight_cable` for radius > 0.

    In the plane of axis k and e, the direction from the axis to the anchor, the centre is r e from
    the datum, the cable leaves at -r cos(th) e + r sin(th) k from it, along cos(th) k + sin(th) e.
    """
    along = wp.dot(relative, axis)
    outward = relative - along * axis
    rho = wp.length(outward)
    e = perpendicular(axis)
    if rho > f64(0.0):
        e = outward / rho
    x = rho - radius
    d2 = x * x + along * along
    s2 = rho * (rho - f64(2.0) * radius) + along * along  # = d2 - r^2, without cancellation
    wrap = f64(0.0)
    length = f64(0.0)
    direction = e
    bend = mat33()
    valid = wp.int32(0)
    if s2 > f64(0.0):
        s = wp.sqrt(s2)
        sine = (s * x + radius * along) / d2
        cosine = (s * along - radius * x) / d2
        wrap = wp.atan2(sine, cosine)
        if wrap < f64(-1.0e-9):  # the anchor is behind the cable that comes from the winch
            wrap += f64(2.0) * PI
        length = radius * wrap + s
        direction = cosine * axis + sine * e
        normal = cosine * e - sine * axis
        side = wp.cross(axis, e)
        swing = f64(1.0) / s
        if rho > f64(1.0e-9) * s:
            swing = sine / rho
        bend = wp.outer(normal, normal) / s + wp.outer(side, side) * swing
        valid = wp.int32(1)
    return length, wrap, direction, bend, valid


@wp.func
def straight_cable(relative: vec3, radius: f64, axis: vec3):
    """Solve one straight cable from its datum over its pulley to its anchor.

    Args:
        relative: Datum to anchor point in W [m].
        radius: Pulley radius [m]; 0 means a fixed eyelet at the datum.
        axis: Unit vector in W along which the cable travels from the winch into the pulley.

    Returns:
        Length datum to anchor with the wrapped arc [m]; wrap [rad]; unit vector from the tangent
        point to the anchor, which is the gradient of the length [-]; its derivative with respect
        to the anchor, the Hessian of the length [1/m]; and 1, or 0 where the anchor is inside the
        pulley (then all else is 0 but the direction).
    """
    length = f64(0.0)
    wrap = f64(0.0)
    direction = vec3()
    bend = mat33()
    valid = wp.int32(1)
    if radius > f64(0.0):
        length, wrap, direction, bend, valid = pulley_cable(relative, radius, axis)
    else:
        length = wp.length(relative)
        if length > f64(0.0):
            direction = relative / length
            unity = wp.identity(n=3, dtype=f64)
            bend = (unity - wp.outer(direction, direction)) / length
    return length, wrap, direction, bend, valid


@wp.kernel
def straight_lengths(
    cables: wp.array2d(dtype=Cable),
    position: wp.array(dtype=vec3),
    rotation: wp.array(dtype=mat33),
    length: wp.array2d(dtype=f64),
    wrap: wp.array2d(dtype=f64),
    direction: wp.array2d(dtype=vec3),
    valid: wp.array2d(dtype=wp.int32),
):
    """Compute lengths, wraps and gradients at known poses; one thread per pose and cable."""
    b, i = wp.tid()
    cable = cables[wp.min(b, cables.shape[0] - 1), i]
    relative = position[b] + rotation[b] * cable.anchor_point - cable.exit_point
    span, angle, unit, _bend, inside = straight_cable(
        relative, cable.pulley_radius, cable.swivel_axis
    )
    length[b, i] = span
    wrap[b, i] = angle
    direction[b, i] = unit
    valid[b, i] = inside


@wp.func
def misfit(
    b: int,
    position: vec3,
    rotation: mat33,
    exit_point: wp.array(dtype=vec3),
    anchor: wp.array(dtype=vec3),
    radius: wp.array(dtype=f64),
    axis: wp.array(dtype=vec3),
    target: wp.array2d(dtype=f64),
):
    """Return half the summed squared length error [m^2], gradient [m], Hessian [-], validity."""
    cost = f64(0.0)
    gradient = vec3()
    hessian = mat33()
    valid = wp.int32(1)
    for i in range(exit_point.shape[0]):
        relative = position + rotation * anchor[i] - exit_point[i]
        length, _wrap, unit, bend, inside = straight_cable(relative, radius[i], axis[i])
        error = length - target[b, i]
        cost += f64(0.5) * error * error
        gradient += error * unit
        hessian += wp.outer(unit, unit) + error * bend
        valid *= inside
    if exit_point.shape[0] == 2:  # under two cables the weight holds the platform in one plane
        first = exit_point[0] - rotation * anchor[0]
        across = wp.cross(
            exit_point[1] - rotation * anchor[1] - first, vec3(f64(0.0), f64(0.0), f64(1.0))
        )
        if wp.length(across) > f64(0.0):
            normal = wp.normalize(across)
            beside = wp.dot(normal, position - first)
            cost += f64(0.5) * beside * beside
            gradient += beside * normal
            hessian += wp.outer(normal, normal)
    return cost, gradient, hessian, valid


@wp.func
def solve_positive(a: mat33, rhs: vec3):
    """Solve a x = rhs by L D L^T; the flag is 0 where a is not safely positive definite."""
    floor = f64(1.0e-10) * (wp.abs(a[0, 0]) + wp.abs(a[1, 1]) + wp.abs(a[2, 2]))
    x = vec3()
    positive = wp.int32(0)
    d0 = a[0, 0]
    if d0 > floor:
        l10 = a[1, 0] / d0
        l20 = a[2, 0] / d0
        d1 = a[1, 1] - l10 * a[1, 0]
        if d1 > floor:
            l21 = (a[2, 1] - l20 * a[1, 0]) / d1
            d2 = a[2, 2] - l20 * a[2, 0] - l21 * l21 * d1
            if d2 > floor:
                y1 = rhs[1] - l10 * rhs[0]
                y2 = rhs[2] - l20 * rhs[0] - l21 * y1
                x2 = y2 / d2
                x1 = y1 / d1 - l21 * x2
                x0 = rhs[0] / d0 - l10 * x1 - l20 * x2
                x = vec3(x0, x1, x2)
                positive = wp.int32(1)
    return x, positive


@wp.kernel
def fit_position(
    target: wp.array2d(dtype=f64),
    rotation: wp.array(dtype=mat33),
    exit_point: wp.array(dtype=vec3),
    anchor: wp.array(dtype=vec3),
    radius: wp.array(dtype=f64),
    axis: wp.array(dtype=vec3),
    tolerance: f64,
    max_iterations: int,
    position: wp.array(dtype=vec3),
    residual: wp.array(dtype=f64),
    converged: wp.array(dtype=wp.int32),
    iterations: wp.array(dtype=wp.int32),
):
    """Find the position of least squared length error by damped Newton.

    The Hessian is the full one, with the curvature of the lengths: lengths that contradict each
    other leave a large residual, at which Gauss-Newton crawls or cycles. `position` holds the
    start on entry and the solution on return.
    """
    b = wp.tid()
    n = exit_point.shape[0]
    cables = f64(n)
    scale = f64(0.0)
    for i in range(n):
        scale = wp.max(scale, wp.abs(target[b, i]))
    turn = rotation[b]
    p = position[b]
    cost, gradient, hessian, valid = misfit(b, p, turn, exit_point, anchor, radius, axis, target)
    mu = f64(0.0)
    count = wp.int32(0)
    while (
        count < max_iterations
        and mu < DAMPING_MAX
        and wp.length(gradient) > f64(0.01) * tolerance * scale
    ):
        count += 1
        step, positive = solve_positive(hessian + mu * wp.identity(n=3, dtype=f64), -gradient)
        gain = f64(-1.0)
        if positive == 1:
            trial = p + step
            cost_1, gradient_1, hessian_1, valid_1 = misfit(
                b, trial, turn, exit_point, anchor, radius, axis, target
            )
            predicted = -wp.dot(gradient, step) - f64(0.5) * wp.dot(step, hessian * step)
            noise = f64(1.0e-15) * scale * wp.sqrt(cables * (cost + cost_1))
            shrinks = wp.length(gradient_1) < wp.length(gradient)
            if cost_1 < cost - noise or (cost_1 <= cost + noise and shrinks):
                gain = f64(1.0)
                if predicted > noise:
                    gain = wp.max((cost - cost_1) / predicted, f64(0.0))
                p = trial
                cost = cost_1
                gradient = gradient_1
                hessian = hessian_1
                valid = valid_1
        if gain < f64(0.25):
            mu = wp.max(f64(4.0) * mu, DAMPING_START * cables)
        elif gain > f64(0.75):
            mu *= f64(0.125)
            if mu < f64(1.0e-3) * DAMPING_START * cables:
                mu = f64(0.0)
    _step, minimum = solve_positive(hessian, gradient)
    done = wp.int32(0)
    if valid == 1 and minimum == 1 and wp.length(gradient) <= tolerance * scale:
        done = wp.int32(1)
    position[b] = p
    residual[b] = wp.sqrt(f64(2.0) * cost / cables)
    converged[b] = done
    iterations[b] = count


@wp.struct
class Straight:
    """A straight cable between its pulley and an anchor."""

    unit: wp.vec3d  # anchor to tangent point
    length: wp.float64  # wrapped arc + distance [m]
    bend: wp.mat33d  # second derivative of the length with respect to the anchor [1/m]


@wp.func
def straight_to(cable: Cable, anchor: wp.vec3d) -> Straight:
    """Return the straight cable to an anchor point, its pulley included."""
    out = Straight()
    length, _wrap, direction, bend, _valid = straight_cable(
        anchor - cable.exit_point, cable.pulley_radius, cable.swivel_axis
    )
    out.length = length
    out.unit = -direction
    out.bend = bend
    return out
