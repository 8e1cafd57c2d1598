"""Eight pixels at once: how the pieces that cross each of them lie to one another, as LLVM vectors.

Numba cannot prove that rows of a block do not overlap and leaves loops over them scalar; so what is done with each pair of pieces is
written as vector instructions here. LLVM lowers eight double lanes to whatever the CPU has.
"""

from __future__ import annotations

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

LANES = 8
STEEPEST = 1e5  # dx / dy up to which x = a + b y is good to NEAR
NEAR = 1e-9  # pixels
ABSENT = 4.0  # a height below the pixel

# rows of a block, LANES numbers each
TOTAL, LEFT, TOP, COUNT, AREA, OPEN, CORNER = range(7)
PIECES = 7
"""Rows before those of the pieces."""
LOW, HIGH, AT, RUN, SIGN, LOW_X, HIGH_X, OWN, ENTERS, LEAVES = range(10)
PIECE_ROWS = 10
# rows of each LANES slabs of a pixel
MIDDLE, THICK = range(2)
SLAB_ROWS = 2
# rows of each piece, scratch of `stacked_area`
X, STEP = range(2)
CROSSING_ROWS = 2

_LANE = ir.VectorType(ir.DoubleType(), LANES)
_LONG = ir.IntType(64)


class _Lanes:
    """A vector of numbers or of truths, with the operators of a formula."""

    def __init__(self, builder, value):
        self.builder, self.value = builder, value

    def _number(self, other):
        return other.value if isinstance(other, _Lanes) else ir.Constant(_LANE, [float(other)] * LANES)

    def _made(self, value):
        return _Lanes(self.builder, value)

    def __add__(self, other):
        return self._made(self.builder.fadd(self.value, self._number(other)))

    def __sub__(self, other):
        return self._made(self.builder.fsub(self.value, self._number(other)))

    def __rsub__(self, other):
        return self._made(self.builder.fsub(self._number(other), self.value))

    def __mul__(self, other):
        return self._made(self.builder.fmul(self.value, self._number(other)))

    def __truediv__(self, other):
        return self._made(self.builder.fdiv(self.value, self._number(other)))

    def _compared(self, how, other):
        return self._made(self.builder.fcmp_ordered(how, self.value, self._number(other)))

    def __lt__(self, other):
        return self._compared("<", other)

    def __le__(self, other):
        return self._compared("<=", other)

    def __gt__(self, other):
        return self._compared(">", other)

    def equals(self, other):
        return self._compared("==", other)

    def __and__(self, other):
        return self._made(self.builder.and_(self.value, other.value))

    def __or__(self, other):
        return self._made(self.builder.or_(self.value, other.value))

    def __invert__(self):
        return self._made(self.builder.not_(self.value))

    def choose(self, yes, no):
        """yes where this is true, else no."""
        return self._made(self.builder.select(self.value, self._number(yes), self._number(no)))

    def least(self, other):
        return (self < other).choose(self, other)

    def most(self, other):
        return (self > other).choose(self, other)

    def size(self):
        return self.most(0.0 - self)

    def floor(self):
        name = f"llvm.floor.v{LANES}f64"
        call = cgutils.get_or_insert_function(self.builder.module, ir.FunctionType(_LANE, [_LANE]), name)
        return self._made(self.builder.call(call, [self.value]))


class _Block:
    """Rows of numbers in memory, of which `first` come before those of the pieces, `each` a piece; and sums in registers."""

    def __init__(self, context, builder, kind, array, first, each):
        self.builder, self._first, self._each = builder, first, each
        self._numbers = context.make_array(kind)(context, builder, array).data

    def _place(self, row, piece, lane=None):
        number = ir.Constant(_LONG, row * LANES)
        if piece is not None:
            skipped = self.builder.mul(piece, ir.Constant(_LONG, self._each * LANES))
            number = self.builder.add(skipped, ir.Constant(_LONG, (self._first + row) * LANES))
        if lane is not None:
            number = self.builder.add(number, lane)
        return self.builder.gep(self._numbers, [number])

    def load(self, row, piece=None):
        value = self.builder.load(self.builder.bitcast(self._place(row, piece), _LANE.as_pointer()))
        value.align = 8
        return _Lanes(self.builder, value)

    def spread(self, lane, row, piece=None):
        """The number of one lane of a row, in all lanes."""
        return _Lanes(self.builder, _splat(self.builder, self.builder.load(self._place(row, piece, lane))))

    def store(self, lanes, row, piece=None):
        self.builder.store(lanes.value, self.builder.bitcast(self._place(row, piece), _LANE.as_pointer())).align = 8

    def number(self, value):
        return _Lanes(self.builder, ir.Constant(_LANE, [float(value)] * LANES))

    def variable(self, first):
        place = cgutils.alloca_once(self.builder, _LANE)
        self.builder.store(self._value(first), place)
        return place

    def read(self, place):
        return _Lanes(self.builder, self.builder.load(place))

    def write(self, lanes, place):
        self.builder.store(self._value(lanes), place)

    def _value(self, lanes):
        return lanes.value if isinstance(lanes, _Lanes) else self.number(lanes).value


def _prepare(block, i, there, rest, flat):
    """Turn the ends of piece i into the rows that the others are compared with; takes its own part from the rest of the sum.

    OWN is what the piece adds to the integral of the winding number over the pixel, given that just left of the pixel's top left corner:
    a chain that comes in through the left side runs to the right, and below it the winding number is less by one.
    """
    left, top = block.load(LEFT), block.load(TOP)
    xa, ya, xb, yb = (block.load(k, i) - origin for k, origin in enumerate((left, top, left, top)))
    level, down, enters, leaves = ya.equals(yb), yb > ya, xa.equals(0.0), xb.equals(0.0)
    run = level.choose(0.0, (xb - xa) / (yb - ya))
    own = (yb - ya) * (1.0 - (xa + xb) * 0.5) - enters.choose(1.0 - ya, 0.0) + leaves.choose(1.0 - yb, 0.0)
    block.write(block.read(rest) - there.choose(own, 0.0), rest)
    block.write(block.read(flat).most((there & (level | ~(run.size() < STEEPEST))).choose(1.0, 0.0)), flat)
    block.store(there.choose(ya.least(yb), ABSENT), LOW, i)
    block.store(there.choose(ya.most(yb), -ABSENT), HIGH, i)
    block.store(xa - ya * run, AT, i)
    block.store(run, RUN, i)
    block.store(there.choose(down.choose(1.0, level.choose(0.0, -1.0)), 0.0), SIGN, i)
    block.store(down.choose(xa, xb), LOW_X, i)
    block.store(down.choose(xb, xa), HIGH_X, i)
    block.store(there.choose(own, 0.0), OWN, i)
    block.store((there & enters).choose(ya, ABSENT), ENTERS, i)
    block.store((there & leaves).choose(yb, ABSENT), LEAVES, i)


def _step_left(block, j, y):
    """What piece j adds to the winding number on the pixel's left side at height y."""
    return (block.load(LEAVES, j) <= y).choose(1.0, 0.0) - (block.load(ENTERS, j) <= y).choose(1.0, 0.0)


def _against(block, i, j, y, x):
    """Piece i, whose middle is (x, y), against piece j: (what j adds to the winding number left of there, the most that a meeting takes
    from the winding number beside i, whether they meet).

    j counts where it is on the left of i, and where they meet it changes sides: where j runs past the middle of i both cases are
    known, else the chain of j goes on there, and a meeting changes the winding number by one. Two ends at the same place are no meeting;
    an end within NEAR of another piece is, as its chain may go on across.
    """
    low_i, high_i, low_j, high_j = block.load(LOW, i), block.load(HIGH, i), block.load(LOW, j), block.load(HIGH, j)
    at_j, run_j, sign = block.load(AT, j), block.load(RUN, j), block.load(SIGN, j)
    low, high = low_i.most(low_j), high_i.least(high_j)
    shift, slope = block.load(AT, i) - at_j, block.load(RUN, i) - run_j
    above, below = shift + slope * low, shift + slope * high
    least, most = above.least(below), above.most(below)
    apart = ((most > NEAR) & (least > -NEAR)) | ((least < -NEAR) & (most < NEAR))
    same_low = low_i.equals(low_j) & block.load(LOW_X, i).equals(block.load(LOW_X, j))
    same_high = high_i.equals(high_j) & block.load(HIGH_X, i).equals(block.load(HIGH_X, j))
    touch = ((above.size() <= NEAR) & ~same_low) | ((below.size() <= NEAR) & ~same_high)
    meet = (~apart | touch) & (low < high)
    past = (low_j <= y) & (y < high_j)
    counted = (past & (at_j + run_j * y < x)).choose(sign, 0.0)
    taken = past.choose(sign.least(0.0) - counted, -1.0)
    return counted + _step_left(block, j, y), meet.choose(taken, 0.0), meet.choose(1.0, 0.0)


def _beside(block, i, n, corner):
    """(winding number just left of the middle of piece i, the least that it can be on either side of it anywhere, meetings)."""
    y = (block.load(LOW, i) + block.load(HIGH, i)) * 0.5
    x = block.load(AT, i) + block.load(RUN, i) * y
    sums = [block.variable(corner + _step_left(block, i, y)), block.variable(0.0), block.variable(0.0)]
    builder = block.builder
    for start, stop in ((ir.Constant(_LONG, 0), i), (builder.add(i, ir.Constant(_LONG, 1)), n)):
        with cgutils.for_range_slice(builder, start, stop, ir.Constant(_LONG, 1)) as (j, _):
            for place, part in zip(sums, _against(block, i, j, y, x), strict=True):
                block.write(block.read(place) + part, place)
    winding, taken, meetings = (block.read(place) for place in sums)
    return winding, winding + block.load(SIGN, i).least(0.0) + taken, meetings


@intrinsic
def settle(typingctx, block, n):
    """Areas in which the winding number is positive, of LANES pixels with n pieces at most.

    block (flat) f8, rows of LANES numbers. Given: TOTAL, the integral of the winding number over each pixel; LEFT and TOP, its corner;
    COUNT, how many pieces it has; and from row PIECES on, PIECE_ROWS rows a piece, of which the first four are xa, ya, xb, yb. Made:
    AREA, and OPEN, which is not zero where pieces meet, or are too flat to tell, and the area is not known; CORNER, the winding number just
    left of the corner; and the rows of the pieces that `stacked_area` needs.

    Every part of a pixel has a piece on its border; from the middle of the piece to there the winding number beside it changes only where
    it meets others. So a pixel is full when nowhere beside a piece it can be less than one. Where no pieces meet, the winding number on
    either side of a piece is the same from end to end, and the pieces with 0 on one side and 1 on the other are the border of the area.
    """
    signature = types.void(types.Array(types.float64, 1, "C"), types.intp)

    def generate(context, builder, sig, args):
        rows, n_ = _Block(context, builder, sig.args[0], args[0], PIECES, PIECE_ROWS), args[1]
        rest, flat = rows.variable(rows.load(TOTAL)), rows.variable(0.0)
        with cgutils.for_range(builder, n_) as loop:
            number = builder.sitofp(loop.index, ir.DoubleType())
            there = rows.load(COUNT) > _Lanes(builder, _splat(builder, number))
            _prepare(rows, loop.index, there, rest, flat)
        corner = (rows.read(rest) + 0.5).floor()
        rows.store(corner, CORNER)
        area, least, meetings = rows.variable((corner > 0.0).choose(1.0, 0.0)), rows.variable(1.0), rows.variable(0.0)
        with cgutils.for_range(builder, n_) as loop:
            i = loop.index
            winding, lowest, met = _beside(rows, i, n_, corner)
            sign, there = rows.load(SIGN, i), rows.load(LOW, i) < rows.load(HIGH, i)
            border = there & winding.least(winding + sign).equals(0.0)
            rows.write(rows.read(area) + border.choose(rows.load(OWN, i), 0.0), area)
            rows.write(rows.read(least).least(there.choose(lowest, 1.0)), least)
            rows.write(rows.read(meetings) + met, meetings)
        told = rows.read(flat).equals(0.0)
        full = told & (rows.read(least) > 0.0)
        rows.store(full.choose(1.0, rows.read(area)), AREA)
        rows.store((full | (told & rows.read(meetings).equals(0.0))).choose(0.0, 1.0), OPEN)
        return context.get_dummy_value()

    return signature, generate


def _crossings(block, lane, n, y, found):
    """Where pieces cross the heights y of one pixel, and by how much the winding number steps there, into the rows of `found`; returns
    the winding number on the pixel's left side.
    """
    winding = found.variable(block.spread(lane, CORNER))
    with cgutils.for_range(block.builder, n) as loop:
        i = loop.index
        here = (block.spread(lane, LOW, i) < y) & (y < block.spread(lane, HIGH, i))
        x = block.spread(lane, AT, i) + block.spread(lane, RUN, i) * y
        found.store(here.choose(x.most(0.0).least(1.0), ABSENT), X, i)
        found.store(here.choose(block.spread(lane, SIGN, i), 0.0), STEP, i)
        left = (block.spread(lane, LEAVES, i) < y).choose(1.0, 0.0) - (block.spread(lane, ENTERS, i) < y).choose(1.0, 0.0)
        found.write(found.read(winding) + left, winding)
    return found.read(winding)


def _widths(found, n, winding):
    """Covered width on each line: where the winding number becomes positive and where it ceases to be. Nothing is sorted: of the crossings
    of a line each looks at all others, those further left come before it, and of those at the same place the first.
    """
    builder, zero, one = found.builder, ir.Constant(_LONG, 0), ir.Constant(_LONG, 1)
    covered, last, before = found.variable(0.0), found.variable(winding), found.variable(0.0)
    with cgutils.for_range(builder, n) as loop:
        i = loop.index
        x, step = found.load(X, i), found.load(STEP, i)
        found.write(winding, before)
        with cgutils.for_range_slice(builder, zero, i, one) as (j, _):
            found.write(found.read(before) + (found.load(X, j) <= x).choose(found.load(STEP, j), 0.0), before)
        with cgutils.for_range_slice(builder, builder.add(i, one), n, one) as (j, _):
            found.write(found.read(before) + (found.load(X, j) < x).choose(found.load(STEP, j), 0.0), before)
        left, right = found.read(before) > 0.0, found.read(before) + step > 0.0
        found.write(found.read(covered) + x * (left.choose(1.0, 0.0) - right.choose(1.0, 0.0)), covered)
        found.write(found.read(last) + step, last)
    return found.read(covered) + (found.read(last) > 0.0).choose(1.0, 0.0)


@intrinsic
def stacked_area(typingctx, block, lane, n, slabs, batches, crossings):
    """f8: the area in which the winding number of a pixel is positive, from slabs in which the pieces are straight and do not meet.

    block: of `settle`, of which this lane is taken, with n pieces. slabs (flat) f8: SLAB_ROWS rows for each of the batches of LANES
    slabs: the MIDDLE of a slab, from the pixel's top, and how THICK it is. crossings (flat) f8: CROSSING_ROWS rows a piece, scratch.
    """
    array = types.Array(types.float64, 1, "C")
    signature = types.float64(array, types.intp, types.intp, array, types.intp, array)

    def generate(context, builder, sig, args):
        rows = _Block(context, builder, array, args[0], PIECES, PIECE_ROWS)
        stack = _Block(context, builder, array, args[3], 0, SLAB_ROWS)
        found = _Block(context, builder, array, args[5], 0, CROSSING_ROWS)
        area = found.variable(0.0)
        with cgutils.for_range(builder, args[4]) as loop:
            winding = _crossings(rows, args[1], args[2], stack.load(MIDDLE, loop.index), found)
            found.write(found.read(area) + _widths(found, args[2], winding) * stack.load(THICK, loop.index), area)
        kind = ir.FunctionType(ir.DoubleType(), [ir.DoubleType(), _LANE])
        add = cgutils.get_or_insert_function(builder.module, kind, f"llvm.vector.reduce.fadd.v{LANES}f64")
        return builder.call(add, [ir.Constant(ir.DoubleType(), 0.0), found.read(area).value])

    return signature, generate


def _splat(builder, number):
    nothing = ir.Constant(_LANE, ir.Undefined)
    one = builder.insert_element(nothing, number, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(one, nothing, ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES))
