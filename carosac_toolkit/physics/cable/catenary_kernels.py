"""One elastic cable in float64 Warp: catenary, run-length stretch, pulley wrap, and derivatives.

The unknown of a cable is ``q``, the tension vector at its upper (exit) end, pointing from the
platform to the exit along the cable. Everything else, derivatives included, is explicit in it:

* free length   L = L_u + run * eps / (1 + eps) - r * theta / (1 + eps),   eps = |q| / EA
* force on the platform   f = q - w * L * z
* vector from anchor to tangent point, the integral of (1/EA + 1/T) F over the cable (Irvine)

With V_a, V_b the vertical parts at exit and anchor, H the horizontal one and T = hypot(H, V),
A = asinh(V_a/H) - asinh(V_b/H) is taken as log1p of a rationalised difference, and every
difference that is proportional to w is divided by w analytically: a straight elastic cable is the
limit w -> 0 of the same code, without loss of digits.
"""

import warp as wp

from carosac_toolkit.physics.cable.straight_line_kernels import straight_cable
from carosac_toolkit.physics.device_kernels import Cable

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

mat66d = wp.types.matrix((6, 6), wp.float64)
vec6d = wp.types.vector(6, wp.float64)

ZERO = wp.constant(wp.float64(0.0))
HALF = wp.constant(wp.float64(0.5))
ONE = wp.constant(wp.float64(1.0))
TWO = wp.constant(wp.float64(2.0))
DIVISION_FLOOR = wp.constant(wp.float64(1.0e-40))  # [N^2] floor of H^2: 1e-20 N


@wp.func
def density_of(cable: Cable, gravity: wp.float64) -> wp.float64:
    """Return the mass per unstrained length [kg/m]."""
    return cable.weight_per_length / gravity


@wp.struct
class Span:
    """The free cable between tangent point and anchor."""

    reach: wp.vec3d  # anchor to tangent point [m]
    compliance: wp.mat33d  # d reach / d q at constant length [m/N]
    feed: wp.float64  # d reach / d length = feed * f [1/N]
    stretch: wp.float64  # elongation, the integral of T / EA [m]


@wp.struct
class Wrap:
    """Departure of the cable from its pulley."""

    tangent_point: wp.vec3d  # in W [m]
    tangent_point_q: wp.mat33d  # d tangent_point / d q [m/N]
    angle: wp.float64  # theta [rad]
    angle_q: wp.vec3d  # d theta / d q [rad/N]


@wp.struct
class HungCable:
    """One cable for given q, anchor and unstrained length."""

    closure: wp.vec3d  # anchor + reach - tangent point [m]; zero where the cable fits
    closure_q: wp.mat33d  # d closure / d q [m/N]
    closure_l: wp.vec3d  # d closure / d unstrained length
    force: wp.vec3d  # on the platform [N]
    force_q: wp.mat33d  # d force / d q
    tangent_point: wp.vec3d  # in W [m]
    free_length: wp.float64  # unstrained, tangent point to anchor [m]


@wp.func
def log1p_over(x: wp.float64) -> wp.float64:
    """Return log(1 + x) / x for x >= 0, exact to rounding."""
    if x < wp.float64(1.0e-4):
        return ONE - x * (HALF - x * (ONE / wp.float64(3.0) - x * wp.float64(0.25)))
    u = ONE + x
    return wp.log(u) / (u - ONE)


@wp.func
def inverse33(a: wp.mat33d) -> wp.mat33d:
    """Invert by elimination a matrix close to symmetric positive definite."""
    l10 = a[1, 0] / a[0, 0]
    l20 = a[2, 0] / a[0, 0]
    u11 = a[1, 1] - l10 * a[0, 1]
    u12 = a[1, 2] - l10 * a[0, 2]
    l21 = (a[2, 1] - l20 * a[0, 1]) / u11
    u22 = a[2, 2] - l20 * a[0, 2] - l21 * u12
    p00 = ONE / a[0, 0]
    p11 = ONE / u11
    p22 = ONE / u22
    # Columns of the inverse by forward and back substitution.
    c20 = (l10 * l21 - l20) * p22
    c10 = (-l10 - u12 * c20) * p11
    c00 = (ONE - a[0, 1] * c10 - a[0, 2] * c20) * p00
    c21 = -l21 * p22
    c11 = (ONE - u12 * c21) * p11
    c01 = (-a[0, 1] * c11 - a[0, 2] * c21) * p00
    c22 = p22
    c12 = -u12 * c22 * p11
    c02 = (-a[0, 1] * c12 - a[0, 2] * c22) * p00
    return wp.mat33d(c00, c01, c02, c10, c11, c12, c20, c21, c22)


@wp.func
def catenary_span(q: wp.vec3d, length: wp.float64, w: wp.float64, ea: wp.float64) -> Span:
    """Evaluate Irvine's elastic catenary from the tension vector at its exit end."""
    h2 = q[0] * q[0] + q[1] * q[1] + DIVISION_FLOOR
    va = q[2]
    vb = q[2] - w * length
    ta = wp.sqrt(h2 + va * va)
    tb = wp.sqrt(h2 + vb * vb)
    # v and tv belong to the end with the smaller |V|, seen as the lower one: v + wL >= |v|.
    v = vb
    tv = tb
    if va + vb < ZERO:
        v = -va
        tv = ta
    if v >= ZERO:
        denominator = v + tv
    else:
        denominator = h2 / (tv - v)
    rise = length * (va + vb) / (ta + tb)  # (Ta - Tb) / w
    y = (length + wp.abs(rise)) / denominator
    slope = y * log1p_over(w * y)  # A / w
    tatb = ta * tb
    cosine = h2 + va * vb
    if cosine >= ZERO:
        bend = length * (ta + tb) / (tatb * (tatb + cosine))
    else:
        bend = (va / ta - vb / tb) / (w * h2)
    axial = length / ea
    lateral = axial + slope
    cross = -rise / tatb
    out = Span()
    out.reach = wp.vec3d(q[0] * lateral, q[1] * lateral, rise + (va - HALF * w * length) * axial)
    cxy = -bend * q[0] * q[1]
    cxz = cross * q[0]
    cyz = cross * q[1]
    out.compliance = wp.mat33d(
        lateral - bend * q[0] * q[0], cxy, cxz,
        cxy, lateral - bend * q[1] * q[1], cyz,
        cxz, cyz, axial + bend * h2,
    )  # fmt: skip
    out.feed = ONE / ea + ONE / tb
    mean = HALF * (length * (ta + tb) + (va + vb) * rise)
    out.stretch = HALF * (mean + h2 * slope) / ea
    return out


@wp.func
def pulley_wrap(q: wp.vec3d, cable: Cable) -> Wrap:
    """Return tangent point and wrap angle of a swivelling pulley; the cable leaves along -q."""
    out = Wrap()
    r = cable.pulley_radius
    if r == ZERO:
        out.tangent_point = cable.exit_point
        return out
    k = cable.swivel_axis
    tension = wp.sqrt(wp.dot(q, q) + DIVISION_FLOOR)
    leaving = -q / tension
    cosine = wp.dot(leaving, k)
    across = leaving - cosine * k
    sine = wp.sqrt(wp.dot(across, across) + wp.float64(1.0e-30))
    e = across / sine
    side = wp.cross(k, e)
    out.angle = wp.atan2(sine, cosine)
    out.angle_q = (k + cosine * (q / tension)) / (tension * sine)
    out.tangent_point = cable.exit_point + r * ((ONE - cosine) * e + sine * k)
    out.tangent_point_q = r * (
        wp.outer(leaving, out.angle_q) - (ONE - cosine) / (tension * sine) * wp.outer(side, side)
    )
    return out


@wp.func
def hang(q: wp.vec3d, anchor: wp.vec3d, unstrained_length: wp.float64, cable: Cable) -> HungCable:
    """Evaluate one cable: closure, force on the platform, and their derivatives."""
    w = cable.weight_per_length
    ea = cable.axial_stiffness
    tension = wp.sqrt(wp.dot(q, q) + DIVISION_FLOOR)
    strained = ONE + tension / ea
    wrap = pulley_wrap(q, cable)
    arc = cable.pulley_radius * wrap.angle
    length = unstrained_length + (cable.run_length * (tension / ea) - arc) / strained
    length_q = (cable.run_length + arc) / (
        strained * strained * ea * tension
    ) * q - cable.pulley_radius / strained * wrap.angle_q
    span = catenary_span(q, length, w, ea)
    out = HungCable()
    out.force = wp.vec3d(q[0], q[1], q[2] - w * length)
    out.closure = anchor + span.reach - wrap.tangent_point
    out.closure_l = span.feed * out.force
    out.closure_q = span.compliance + wp.outer(out.closure_l, length_q) - wrap.tangent_point_q
    out.force_q = wp.identity(n=3, dtype=wp.float64) - wp.outer(wp.vec3d(ZERO, ZERO, w), length_q)
    out.tangent_point = wrap.tangent_point
    out.free_length = length
    return out


@wp.func
def taut_tension(chord: wp.float64, span: wp.float64, length: wp.float64, w: wp.float64,
                 ea: wp.float64) -> wp.float64:  # fmt: skip
    """Return the mean tension of a shallow cable: T^3/EA - s T^2 = (w h L/c)^2 / 24."""
    strain = (chord - length) / length
    load = w * span * length / chord
    b = load * load / wp.float64(24.0)
    root = wp.cbrt(ea * b)
    t = root + wp.max(strain, ZERO) * ea
    if strain < ZERO:
        t = wp.min(root, wp.sqrt(b / -strain))
    for _i in range(8):
        t -= (t * t * (t / ea - strain) - b) / (
            t * (wp.float64(3.0) * t / ea - TWO * strain) + DIVISION_FLOOR
        )
    return t


@wp.func
def guess_tension_vector(
    d: wp.vec3d, length: wp.float64, w: wp.float64, ea: wp.float64
) -> wp.vec3d:
    """Guess q for a cable of this length hanging between two points d apart."""
    span = wp.sqrt(d[0] * d[0] + d[1] * d[1])
    chord = wp.max(wp.sqrt(wp.dot(d, d)), wp.float64(1.0e-12) * length)
    if length < wp.float64(1.03) * chord:
        t = taut_tension(chord, span, length, w, ea)
        return t / chord * d + wp.vec3d(ZERO, ZERO, HALF * w * length)
    # Deep sag: sinh(x)/x = sqrt(L^2 - z^2)/h, from an expansion for small and large x.
    ratio = wp.sqrt((length - d[2]) * (length + d[2])) / wp.max(span, wp.float64(1.0e-9) * length)
    x = wp.sqrt(wp.float64(6.0) * (ratio - ONE))
    if ratio > wp.float64(3.0):
        x = wp.log(TWO * ratio)
        x += wp.log(x)
    for _i in range(4):
        x -= (wp.sinh(x) - ratio * x) / (wp.cosh(x) - ratio)
    h = w * span / (TWO * x)
    vertical = HALF * w * (length + d[2] / wp.tanh(x))
    direction = h / wp.max(span, wp.float64(1.0e-9) * length)
    return wp.vec3d(direction * d[0], direction * d[1], vertical)


@wp.func
def guess_cable(anchor: wp.vec3d, unstrained_length: wp.float64, cable: Cable) -> wp.vec3d:
    """Guess q for a cable of the robot: pulley and run by their straight geometry."""
    whole, wrap, direction, _bend, _valid = straight_cable(
        anchor - cable.exit_point, cable.pulley_radius, cable.swivel_axis
    )
    arc = cable.pulley_radius * wrap
    length = unstrained_length - arc
    d = (arc - whole) * direction
    length = wp.max(length, wp.float64(1.0e-3) * unstrained_length)
    ea = cable.axial_stiffness * length / (length + cable.run_length)
    return guess_tension_vector(d, length, cable.weight_per_length, ea)


@wp.struct
class SettledCable:
    """A cable after its own Newton iteration."""

    q: wp.vec3d
    hanging: HungCable
    inverse: wp.mat33d  # (d closure / d q)^-1 [N/m]
    iterations: int


@wp.func
def settle(q0: wp.vec3d, anchor: wp.vec3d, unstrained_length: wp.float64, cable: Cable,
           tolerance: wp.float64, limit: int) -> SettledCable:  # fmt: skip
    """Solve closure = 0 for one cable by damped Newton.

    The closure is the gradient of a convex function of q (its complementary energy less the work
    of the ends), so the step is halved only while the slope along it has turned round and grown.
    """
    q = q0
    state = hang(q, anchor, unstrained_length, cable)
    inverse = inverse33(state.closure_q)
    count = int(0)
    going = wp.length(state.closure) > tolerance
    while going:
        step = -(inverse * state.closure)
        slope = wp.dot(step, state.closure)
        trial = hang(q + step, anchor, unstrained_length, cable)
        halvings = int(0)
        while halvings < 40 and not (
            wp.abs(wp.dot(step, trial.closure)) <= wp.float64(0.95) * wp.abs(slope)
            or wp.length(trial.closure) <= tolerance
        ):
            step = step * HALF
            slope = slope * HALF
            trial = hang(q + step, anchor, unstrained_length, cable)
            halvings += 1
        q = q + step
        state = trial
        inverse = inverse33(state.closure_q)
        count += 1
        going = wp.length(state.closure) > tolerance and count < limit
    out = SettledCable()
    out.q = q
    out.hanging = state
    out.inverse = inverse
    out.iterations = count
    return out
