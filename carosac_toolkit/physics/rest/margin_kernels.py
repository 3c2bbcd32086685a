"""The largest margin of tensions to their limits: a small linear program, solved exactly.

    maximise s   subject to   A x = b,   lower_i + s <= x_i <= upper_i - s

for the tensions x_i. Further unknowns, rotations, have no limits but a trust region |x_j| <= reach.
Gauss-Jordan elimination gives x = x_p + N z, so that s is the height of a concave polyhedron over
z; the simplex method climbs it from x_p, where s = min(x - lower, upper - x) is always allowed. Its
multipliers l >= 0, of sum 1, prove the result: N^T (l_lower - l_upper) = 0 means that no
other balanced tensions have a margin over sum l (x - lower) + sum l (upper - x).
"""

import warp as wp

from carosac_toolkit.physics.cable.catenary_kernels import DIVISION_FLOOR, ONE, ZERO, vec6d

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

RANK_PIVOT_MIN = wp.constant(
    wp.float64(1.0e-11)
)  # of the largest pivot: a smaller one counts as none
ZERO_COST = wp.constant(wp.float64(1.0e-11))  # N of margin per N of slack
ZERO_PIVOT = wp.constant(wp.float64(1.0e-10))
STEEPEST_PIVOTS = wp.constant(
    40
)  # pivots by the steepest rule, then by Bland's, which cannot cycle
SIMPLEX_PIVOTS_MAX = wp.constant(1000)
INERT_COLUMN = wp.constant(-1000000)  # a column that moves no tension

MARGIN_UNSOLVED = wp.constant(0)
MARGIN_SOLVED = wp.constant(1)
MARGIN_UNBALANCED = wp.constant(2)  # A x = b has no solution


@wp.struct
class MarginWork:
    """Work arrays of a linear program, one row per thread; c unknowns of which n are tensions."""

    rows: wp.array3d(dtype=wp.float64)  # (lines, 6, c + 1)
    order: wp.array2d(dtype=int)  # (lines, c)
    null: wp.array3d(dtype=wp.float64)  # (lines, c, c + 1): columns of N, then x_p
    table: wp.array3d(dtype=wp.float64)  # (lines, 2 c + 1, c + 2)
    row_of: wp.array2d(dtype=int)  # (lines, 2 c): names of the basic variables; slacks are >= 0
    column_of: wp.array2d(dtype=int)  # (lines, c + 1)
    weight: wp.array2d(dtype=wp.float64)  # (lines, 2 c): multipliers of the slacks


@wp.struct
class Space:
    """The solutions of A x = b."""

    rank: int
    balanced: int  # 0 where there are none


@wp.func
def set_rows(
    column: wp.array2d(dtype=vec6d), b: int, count: int, target: vec6d, line: int, work: MarginWork
) -> wp.float64:
    """Fill in A and b; returns the largest entry of A."""
    size = wp.float64(0.0)
    for j in range(count):
        work.order[line, j] = j
        for i in range(6):
            work.rows[line, i, j] = column[b, j][i]
            size = wp.max(size, wp.abs(column[b, j][i]))
    for i in range(6):
        work.rows[line, i, count] = target[i]
    return size


@wp.func
def bring_pivot(line: int, k: int, count: int, work: MarginWork) -> wp.float64:
    """Exchange rows and columns so that the largest entry left is at k, k; returns it."""
    r = int(k)
    c = int(k)
    for i in range(k, 6):
        for j in range(k, count):
            if wp.abs(work.rows[line, i, j]) > wp.abs(work.rows[line, r, c]):
                r = i
                c = j
    for j in range(count + 1):
        kept = work.rows[line, k, j]
        work.rows[line, k, j] = work.rows[line, r, j]
        work.rows[line, r, j] = kept
    for i in range(6):
        kept = work.rows[line, i, k]
        work.rows[line, i, k] = work.rows[line, i, c]
        work.rows[line, i, c] = kept
    name = work.order[line, k]
    work.order[line, k] = work.order[line, c]
    work.order[line, c] = name
    return work.rows[line, k, k]


@wp.func
def clear_column(line: int, k: int, count: int, work: MarginWork):
    """Scale row k to a pivot of one and take it out of the other rows."""
    pivot = work.rows[line, k, k]
    for j in range(k, count + 1):
        work.rows[line, k, j] = work.rows[line, k, j] / pivot
    for i in range(6):
        f = work.rows[line, i, k]
        if i != k and f != ZERO:
            for j in range(k, count + 1):
                work.rows[line, i, j] = work.rows[line, i, j] - f * work.rows[line, k, j]


@wp.func
def eliminate(
    column: wp.array2d(dtype=vec6d), b: int, count: int, target: vec6d, line: int, work: MarginWork
) -> Space:
    """Eliminate by Gauss-Jordan with complete pivoting.

    Then unknown order[k], k < rank, is rows[k, count] - sum over j >= rank of rows[k, j] times
    unknown order[j].
    """
    size = set_rows(column, b, count, target, line, work)
    out = Space()
    going = bool(True)
    while going and out.rank < wp.min(6, count):
        going = wp.abs(bring_pivot(line, out.rank, count, work)) > RANK_PIVOT_MIN * size
        if going:
            clear_column(line, out.rank, count, work)
            out.rank = out.rank + 1
    out.balanced = 1
    for i in range(out.rank, 6):
        if wp.abs(work.rows[line, i, count]) > wp.float64(1.0e-9) * (
            wp.length(target) + DIVISION_FLOOR
        ):
            out.balanced = 0
    return out


@wp.func
def set_null_space(line: int, count: int, rank: int, work: MarginWork):
    """Set columns 0 to count - rank - 1 of `null` to N, and the next one to x_p."""
    free = count - rank
    for j in range(count):
        for c in range(free + 1):
            work.null[line, j, c] = ZERO
    for c in range(free):
        most = wp.float64(1.0)
        for k in range(rank):
            most = wp.max(most, wp.abs(work.rows[line, k, rank + c]))
        work.null[line, work.order[line, rank + c], c] = ONE / most
        for k in range(rank):
            work.null[line, work.order[line, k], c] = -work.rows[line, k, rank + c] / most
    for k in range(rank):
        work.null[line, work.order[line, k], free] = work.rows[line, k, count]


@wp.func
def along(line: int, c: int, other: int, count: int, work: MarginWork) -> wp.float64:
    """Return the scalar product of two columns of the null space."""
    out = wp.float64(0.0)
    for j in range(count):
        out += work.null[line, j, c] * work.null[line, j, other]
    return out


@wp.func
def orthogonalise(line: int, count: int, free: int, work: MarginWork):
    """Make N orthonormal, by Gram and Schmidt."""
    for c in range(free):
        for other in range(c):
            part = along(line, c, other, count, work)
            for j in range(count):
                work.null[line, j, c] = work.null[line, j, c] - part * work.null[line, j, other]
        size = wp.sqrt(along(line, c, c, count, work))
        for j in range(count):
            work.null[line, j, c] = work.null[line, j, c] / size


@wp.func
def come_near(
    line: int,
    b: int,
    count: int,
    free: int,
    work: MarginWork,
    unknowns: wp.array2d(dtype=wp.float64),
):
    """Make N orthonormal and x_p the solution nearest to `unknowns`."""
    orthogonalise(line, count, free, work)
    orthogonalise(line, count, free, work)
    for c in range(free):
        part = wp.float64(0.0)
        for j in range(count):
            part += work.null[line, j, c] * (unknowns[b, j] - work.null[line, j, free])
        for j in range(count):
            work.null[line, j, free] = work.null[line, j, free] + part * work.null[line, j, c]


@wp.func
def exchange(line: int, r: int, e: int, height: int, width: int, work: MarginWork):
    """Exchange the variable of row r and that of column e: a simplex pivot."""
    pivot = work.table[line, r, e]
    for c in range(width + 1):
        work.table[line, r, c] = -work.table[line, r, c] / pivot
    work.table[line, r, e] = ONE / pivot
    for j in range(height + 1):
        f = work.table[line, j, e]
        if j != r and f != ZERO:
            for c in range(width + 1):
                work.table[line, j, c] = work.table[line, j, c] + f * work.table[line, r, c]
            work.table[line, j, e] = f * work.table[line, r, e]
    kept = work.row_of[line, r]
    work.row_of[line, r] = work.column_of[line, e]
    work.column_of[line, e] = kept


@wp.func
def blocking_row(
    line: int, e: int, sign: wp.float64, height: int, width: int, work: MarginWork
) -> int:
    """Return the slack that reaches zero first along a column; ties by lowest name; -1: none."""
    out = int(-1)
    least = wp.float64(0.0)
    for j in range(height):
        fall = -sign * work.table[line, j, e]
        if work.row_of[line, j] >= 0 and fall > ZERO_PIVOT:
            ratio = wp.max(work.table[line, j, width], ZERO) / fall
            lower_name = (
                out >= 0 and ratio == least and work.row_of[line, j] < work.row_of[line, out]
            )
            if out < 0 or ratio < least or lower_name:
                out = j
                least = ratio
    return out


@wp.func
def entering_column(line: int, height: int, width: int, bland: bool, work: MarginWork) -> int:
    """Return a slack whose growth raises the margin, or -1 at the top."""
    out = int(-1)
    for c in range(width):
        cost = work.table[line, height, c]
        if work.column_of[line, c] != INERT_COLUMN and cost > ZERO_COST:
            if out < 0:
                out = c
            elif bland and work.column_of[line, c] < work.column_of[line, out]:
                out = c
            elif not bland and cost > work.table[line, height, out]:
                out = c
    return out


@wp.func
def climb(line: int, height: int, width: int, work: MarginWork) -> int:
    """Run the simplex method from a feasible point; MARGIN_SOLVED or MARGIN_UNSOLVED."""
    for back in range(width):  # the margin itself, the last column, comes first
        e = width - 1 - back
        sign = wp.where(work.table[line, height, e] < ZERO, -ONE, ONE)
        r = blocking_row(line, e, sign, height, width, work)
        if r < 0 and wp.abs(work.table[line, height, e]) <= ZERO_COST:
            r = blocking_row(line, e, -sign, height, width, work)
        if r < 0:
            work.column_of[line, e] = INERT_COLUMN
        else:
            exchange(line, r, e, height, width, work)
    for pivots in range(SIMPLEX_PIVOTS_MAX):
        e = entering_column(line, height, width, pivots > STEEPEST_PIVOTS, work)
        if e < 0:
            return MARGIN_SOLVED
        r = blocking_row(line, e, ONE, height, width, work)
        if r < 0:
            return MARGIN_UNSOLVED
        exchange(line, r, e, height, width, work)
    return MARGIN_UNSOLVED


@wp.func
def set_table(line: int, b: int, n: int, count: int, free: int, reach: wp.float64,
              lower: wp.array2d(dtype=wp.float64), upper: wp.array2d(dtype=wp.float64),
              work: MarginWork):  # fmt: skip
    """Set slacks over (z, s) at x_p: n lower limits, n upper ones, then the trust region."""
    height = 2 * count
    start = wp.float64(1.0e300)
    for i in range(n):
        x = work.null[line, i, free]
        start = wp.min(start, wp.min(x - lower[b, i], upper[b, i] - x))
    for j in range(count):
        for side in range(2):
            row = wp.where(j < n, side * n + j, 2 * n + side * (count - n) + j - n)
            sign = wp.where(side == 0, ONE, -ONE)
            for c in range(free):
                work.table[line, row, c] = sign * work.null[line, j, c]
            work.table[line, row, free] = wp.where(j < n, -ONE, ZERO)
            rest = reach
            if j < n:
                limit = wp.where(side == 0, lower[b, j], upper[b, j])
                rest = sign * (work.null[line, j, free] - limit) - start
            work.table[line, row, free + 1] = rest
            work.row_of[line, row] = row
    for c in range(free + 1):
        work.table[line, height, c] = ZERO
        work.column_of[line, c] = -1 - c
    work.table[line, height, free] = ONE
    work.table[line, height, free + 1] = start


@wp.struct
class Margin:
    """The answer of one linear program."""

    status: int
    margin: wp.float64  # of the unknowns found [N]
    gap: wp.float64  # no other balanced tensions have a margin larger by more than this [N]


@wp.func
def read_table(line: int, b: int, n: int, count: int, free: int, work: MarginWork,
               unknowns: wp.array2d(dtype=wp.float64)):  # fmt: skip
    """Read unknowns and multipliers off the final table."""
    height = 2 * count
    for j in range(height):
        work.weight[line, j] = ZERO
    total = wp.float64(0.0)
    for c in range(free + 1):
        name = work.column_of[line, c]
        if name >= 0:
            work.weight[line, name] = wp.max(-work.table[line, height, c], ZERO)
            total += wp.where(name < 2 * n, work.weight[line, name], ZERO)
    for j in range(height):
        work.weight[line, j] = work.weight[line, j] / (total + DIVISION_FLOOR)
    for j in range(count):
        unknowns[b, j] = work.null[line, j, free]
    for row in range(height):
        c = -1 - work.row_of[line, row]
        if c >= 0 and c < free:
            z = work.table[line, row, free + 1]
            for j in range(count):
                unknowns[b, j] = unknowns[b, j] + work.null[line, j, c] * z


@wp.func
def slope_left(line: int, n: int, count: int, free: int, work: MarginWork) -> wp.float64:
    """Return the sum over columns of |N^T (l_lower - l_upper)|: zero for proving multipliers."""
    out = wp.float64(0.0)
    for c in range(free):
        slope = wp.float64(0.0)
        for j in range(count):
            up = wp.where(j < n, j, n + j)
            down = wp.where(j < n, n + j, count + j)
            slope += (work.weight[line, up] - work.weight[line, down]) * work.null[line, j, c]
        out += wp.abs(slope)
    return out


@wp.func
def judge(line: int, b: int, n: int, count: int, free: int, reach: wp.float64,
          lower: wp.array2d(dtype=wp.float64), upper: wp.array2d(dtype=wp.float64),
          work: MarginWork, unknowns: wp.array2d(dtype=wp.float64)) -> Margin:  # fmt: skip
    """Return the margin of the unknowns found, with a bound by weak duality."""
    out = Margin()
    out.margin = wp.float64(1.0e300)
    bound = wp.float64(0.0)
    span = wp.float64(0.0)
    for i in range(n):
        low = unknowns[b, i] - lower[b, i]
        high = upper[b, i] - unknowns[b, i]
        out.margin = wp.min(out.margin, wp.min(low, high))
        bound += work.weight[line, i] * low + work.weight[line, n + i] * high
        span += upper[b, i] - lower[b, i] + wp.abs(unknowns[b, i])
    for j in range(n, count):
        x = unknowns[b, j] - work.null[line, j, free]
        bound += work.weight[line, n + j] * (reach + x)
        bound += work.weight[line, count + j] * (reach - x)
        span += wp.float64(2.0) * reach
    out.gap = wp.abs(bound - out.margin) + span * slope_left(line, n, count, free, work)
    return out


@wp.func
def nearest_balance(column: wp.array2d(dtype=vec6d), b: int, count: int, target: vec6d, line: int,
                    work: MarginWork, unknowns: wp.array2d(dtype=wp.float64)) -> int:  # fmt: skip
    """Move `unknowns` to the nearest solution of A x = b; 0 where there is none."""
    space = eliminate(column, b, count, target, line, work)
    if space.balanced == 1:
        set_null_space(line, count, space.rank, work)
        come_near(line, b, count, count - space.rank, work, unknowns)
        for j in range(count):
            unknowns[b, j] = work.null[line, j, count - space.rank]
    return space.balanced


@wp.func
def largest_margin(column: wp.array2d(dtype=vec6d), b: int, n: int, count: int, target: vec6d,
                   reach: wp.float64, lower: wp.array2d(dtype=wp.float64),
                   upper: wp.array2d(dtype=wp.float64), line: int, work: MarginWork,
                   unknowns: wp.array2d(dtype=wp.float64)) -> Margin:  # fmt: skip
    """Solve for n tensions and count - n unlimited unknowns, near what `unknowns` holds."""
    out = Margin()
    out.status = MARGIN_UNBALANCED
    space = eliminate(column, b, count, target, line, work)
    if space.balanced == 1:
        set_null_space(line, count, space.rank, work)
        free = count - space.rank
        come_near(line, b, count, free, work, unknowns)
        set_table(line, b, n, count, free, reach, lower, upper, work)
        status = climb(line, 2 * count, free + 1, work)
        read_table(line, b, n, count, free, work, unknowns)
        out = judge(line, b, n, count, free, reach, lower, upper, work, unknowns)
        out.status = status
    return out
