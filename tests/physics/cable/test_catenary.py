"""The elastic catenary against known numbers, an independent solution and its own limits."""

import numpy as np
import pytest

import carosac_toolkit as ct
from carosac_toolkit.base.errors import InvalidField
from tests import reference

# span, rise, L0 [m], EA [N], w [N/m] -> H, V_lower, V_upper [N]; solved elsewhere, independently.
KNOWN = np.array(
    [
        [400, 200, 500, 7.51e12, 200, 43694.60462, -22365.58945, 77634.41055],
        [89.9, 59.2, 130, 7.51e8, 881.05, 31373.23488, -26650.3387, 87886.1613],
        [246.22420940032947, 263.55766330843164, 360.6256626239693, 7e8, 3.08735,
         71116.8172, 75567.26582, 76680.64346],
        [246.22420940032947, 263.55766330843164, 360.64566262396926, 7e8, 3.08735,
         46077.27117, 48765.37304, 49878.81243],
        [246.22420940032947, 263.55766330843164, 360.63566262396927, 7e8, 3.08735,
         58377.24142, 61931.00444, 63044.41296],
        [5, 3, 12, 950000, 0.1035, 0.1063352646, -0.463341058, 0.778658942],
    ]
)  # fmt: skip


def random_cables(rng, count):
    """Taut (strain 1e-6 to 1e-2), sagging and slack (up to 3 chords) cables, EA over 6 decades."""
    chord = 10.0 ** rng.uniform(-1.0, 2.5, count)
    elevation = rng.uniform(-np.pi / 2, np.pi / 2, count)
    elevation[: count // 100] = np.pi / 2  # vertical ones
    taut = 1.0 / (1.0 + 10.0 ** rng.uniform(-6.0, -2.0, count))
    sagging = 1.0 + 10.0 ** rng.uniform(-6.0, 0.0, count)
    slack = rng.uniform(1.0, 3.0, count)
    ratio = np.choose(rng.integers(0, 3, count), [taut, sagging, slack])
    stiffness = 10.0 ** rng.uniform(3.0, 9.0, count)
    weight = 10.0 ** rng.uniform(-2.0, 2.0, count)
    span = np.maximum(chord * np.cos(elevation), 0.0)
    return span, chord * np.sin(elevation), chord * ratio, weight, stiffness


def test_known_cables_to_1e_8():
    span, rise, length, stiffness, weight, h, lower, upper = KNOWN.T
    solution = ct.catenary.solve(span, rise, length, weight, stiffness)
    assert solution.converged.all()
    for value, expected in (
        (solution.horizontal, h),
        (solution.vertical_lower, lower),
        (solution.vertical_upper, upper),
    ):
        assert value == pytest.approx(expected, rel=1e-8)


def test_every_random_cable_converges_and_closes():
    span, rise, length, weight, stiffness = random_cables(np.random.default_rng(1), 100_000)
    solution = ct.catenary.solve(span, rise, length, weight, stiffness)
    assert solution.converged.all()
    assert (solution.closure / length).max() < 1e-9
    assert (solution.horizontal >= 0.0).all()


def test_agrees_with_an_independent_solution():
    rng = np.random.default_rng(2)
    cables = np.array(random_cables(rng, 20_000)).T
    cables = cables[cables[:, 0] > 1e-3 * cables[:, 2]][:200]
    solution = ct.catenary.solve(*cables.T)
    for k, cable in enumerate(cables):
        h, v = reference.catenary(*cable)
        scale = np.hypot(h, v)
        assert solution.horizontal[k] == pytest.approx(h, rel=1e-9, abs=1e-9 * scale)
        assert solution.vertical_lower[k] == pytest.approx(v, rel=1e-9, abs=1e-9 * scale)


def test_jacobian_agrees_with_finite_differences():
    span, rise, length, weight, stiffness = random_cables(np.random.default_rng(3), 4000)
    keep = span > 1e-3 * length
    span, rise, length, weight, stiffness = (
        a[keep] for a in (span, rise, length, weight, stiffness)
    )
    solution = ct.catenary.solve(span, rise, length, weight, stiffness)
    size = np.abs(solution.jacobian).max(axis=(1, 2))
    # A step that changes the tension by a 1e-4th, extrapolated from two step sizes (error h^4).
    step = 1e-4 * np.hypot(solution.horizontal, solution.vertical_lower) / size
    step = np.minimum(step, 1e-4 * span)

    def slope(h, along):
        ends = []
        for sign in (1.0, -1.0):
            x = span + sign * h * (along == 0)
            z = rise + sign * h * (along == 1)
            c = ct.catenary.solve(x, z, length, weight, stiffness)
            ends.append(np.stack([c.horizontal, c.vertical_lower], axis=-1))
        return (ends[0] - ends[1]) / (2.0 * h)[:, None]

    for along in (0, 1):
        difference = (4.0 * slope(step / 2.0, along) - slope(step, along)) / 3.0
        error = np.abs(difference - solution.jacobian[:, :, along]).max(axis=1) / size
        # Closure of 1e-16 L divided by the step is the noise of the difference itself.
        noise = 1e-15 * (length + span) / step
        assert (error < 1e-6 + 10.0 * noise).all()
        assert np.median(error) < 1e-8


def test_a_vertical_slack_cable_is_the_limit_of_a_nearly_vertical_one():
    weight, length, rise = 0.1, 12.0, 8.0
    solution = ct.catenary.solve([0.0, 1e-9, 1e-6], [rise] * 3, [length] * 3, weight, 1e9)
    assert solution.converged.all()
    # Two strands hang down: the upper carries (L + rise) / 2 of the weight, the lower the rest.
    assert solution.vertical_upper == pytest.approx(weight * (length + rise) / 2, rel=1e-6)
    assert solution.vertical_lower == pytest.approx(-weight * (length - rise) / 2, rel=1e-6)
    assert (np.diff(solution.horizontal) > 0.0).all()
    assert solution.horizontal[2] < 1e-6 * weight * length


def test_a_taut_vertical_cable_is_a_spring_with_weight():
    weight, length, rise, stiffness = 2.0, 10.0, 10.05, 1e5
    solution = ct.catenary.solve([0.0], [rise], [length], weight, stiffness)
    lower = stiffness * (rise - length) / length - weight * length / 2
    assert solution.vertical_lower[0] == pytest.approx(lower, rel=1e-9)
    assert solution.horizontal[0] == pytest.approx(0.0, abs=1e-12)


def test_a_light_cable_tends_to_a_straight_spring():
    span, rise, length, stiffness = 6.0, 8.0, 9.99, 1e6
    tension = stiffness * (10.0 - length) / length
    previous = np.inf
    for weight in (1.0, 0.1, 0.01, 0.0):
        solution = ct.catenary.solve([span], [rise], [length], weight, stiffness)
        error = abs(solution.horizontal[0] - 0.6 * tension)
        assert error <= previous
        previous = error
    assert solution.horizontal[0] == pytest.approx(0.6 * tension, rel=1e-12)
    assert solution.vertical_lower[0] == pytest.approx(0.8 * tension, rel=1e-12)


def test_mirrored_ends_swap_their_forces():
    up = ct.catenary.solve([5.0], [3.0], [7.0], 0.5, 1e5)
    down = ct.catenary.solve([5.0], [-3.0], [7.0], 0.5, 1e5)
    assert down.horizontal == pytest.approx(up.horizontal, rel=1e-12)
    assert down.vertical_lower == pytest.approx(-up.vertical_upper, rel=1e-12)


def test_no_solution_is_a_status_and_never_a_number():
    solution = ct.catenary.solve(
        [3.0, 3.0, 3.0, 3.0], [4.0] * 4, [0.0, -1.0, 6.0, 6.0], [1.0, 1.0, 0.0, 1.0], 1e5
    )
    assert solution.converged.tolist() == [False, False, False, True]
    for field in ("horizontal", "vertical_lower", "vertical_upper", "closure"):
        assert np.isnan(getattr(solution, field)).tolist() == [True, True, True, False]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"span": [-1.0]}, r"span\[0\]: got -1.0; allowed: span >= 0"),
        ({"axial_stiffness": 0.0}, r"axial_stiffness\[0\]: got 0.0; allowed: axial_stiffness > 0"),
        ({"weight_per_length": -2.0}, r"weight_per_length\[0\]: got -2.0; .*>= 0"),
        ({"rise": [np.nan]}, r"rise\[0\]: got nan; allowed: a finite number"),
        ({"rise": [1.0, 2.0]}, r"rise: got shape \(2,\); allowed: shape \(1,\), as span"),
        ({"span": 3.0}, r"span: got shape \(\); allowed: shape \(B,\), B >= 1"),
        ({"span": "wide"}, r"span: got 'wide'; allowed: numbers"),
    ],
)
def test_bad_arguments_are_named(change, message):
    arguments = {
        "span": [3.0],
        "rise": [4.0],
        "unstrained_length": [6.0],
        "weight_per_length": 1.0,
        "axial_stiffness": 1e5,
    }
    with pytest.raises(InvalidField, match=message):
        ct.catenary.solve(**(arguments | change))
