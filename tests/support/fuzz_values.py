"""Recordings whose text is sound and whose numbers are hostile: zeros, one-ulp steps, repeats, huge
and tiny scales, clocks without resolution."""

import math
from collections.abc import Callable
from random import Random

Column = list[float]

SCALES = (1e300, 1e-300, 1e155, 1e-155, 1e18, 1e-18, 1e-308, 1e-320, -1.0, 57.3)
LEVELS = (1.0, -1.0, 0.0, 1e-3, 1e9, 1e300, 1e-300, 5e-324)
#: factors of the sampling period
PERIODS = (1e-28, 1e-300, 1e-320, 1e-9, 1e-3, 1e3, 1e9, 1e28, 1e300)
#: offsets of the stamps; the larger ones leave no digit for the period
STARTS = (1e9, 1.7e9, 1e14, 1e17, -1e17, 1e300)


# ---- columns --------------------


def zeros(random: Random, column: Column) -> Column:
    """Zeros in one half, in a stretch, in random samples, or everywhere."""
    count = len(column)
    first, last = sorted((random.randint(0, count), random.randint(0, count)))
    share = random.random()
    part = random.choice(("all", "first", "second", "second", "stretch", "scattered"))
    is_zero: Callable[[int], bool] = {
        "all": lambda k: True,
        "first": lambda k: k < count // 2,
        "second": lambda k: k >= count // 2,
        "stretch": lambda k: first <= k < last,
        "scattered": lambda k: random.random() < share,
    }[part]
    zero = random.choice((0.0, 0.0, -0.0))
    return [zero if is_zero(k) else value for k, value in enumerate(column)]


def one_ulp(random: Random, column: Column) -> Column:
    """Values that differ by one unit in the last place: two in turn, or around the recorded
    ones."""
    direction = random.choice((math.inf, -math.inf))
    if random.random() < 0.3:
        return [math.nextafter(v, direction) if random.random() < 0.5 else v for v in column]
    level = random.choice((*LEVELS, *column[:1]))
    other = math.nextafter(level, direction)
    every = random.choice((2, 2, 3, 10, max(len(column) // 2, 1)))
    return [level if k % every else other for k in range(len(column))]


def repeats(random: Random, column: Column) -> Column:
    """Values that come back: held samples, two levels, one sample that differs, equal jumps."""
    count = len(column)
    kind = random.choice(("held", "two", "single", "period", "pulses", "jumps"))
    every = random.choice((2, 3, 7, 13, 50))
    low, high = random.choice(LEVELS), random.choice(LEVELS)
    if kind == "held":
        return [column[k - k % every] for k in range(count)]
    if kind == "two":
        return [low if k % every else high for k in range(count)]
    if kind == "single":
        at = random.randrange(count)
        return [high if k == at else low for k in range(count)]
    if kind == "period":
        return [column[k % every] if k % every < count else low for k in range(count)]
    if kind == "pulses":
        level, values = 0.0, []
        for k in range(count):
            level += random.choice((100.0, 250.0)) if random.random() < 0.01 else 0.0
            values.append(level + (k % every == every // 2))
        return values
    return [float(k // every) for k in range(count)]


def scales(random: Random, column: Column) -> Column:
    factor = random.choice(SCALES)
    return [value * factor for value in column]


def offsets(random: Random, column: Column) -> Column:
    offset = random.choice((1e6, 1e12, 1e15, 1e17, -1e300))
    return [value + offset for value in column]


def functions(random: Random, column: Column) -> Column:
    """A counter, a ramp, a decay, signs in turn, or noise of a given size."""
    size = random.choice((1e-300, 1e-9, 1.0, 1e9, 1e300))
    function: Callable[[int], float] = {
        "counter": float,
        "ramp": lambda k: size * k,
        "decay": lambda k: size * 0.5**k,
        "signs": lambda k: size * (-1) ** k,
        "noise": lambda k: size * random.uniform(-1, 1),
    }[random.choice(("counter", "ramp", "decay", "signs", "noise"))]
    return [function(k) for k in range(len(column))]


CHANGES: tuple[Callable[[Random, Column], Column], ...] = (
    zeros,
    zeros,
    one_ulp,
    repeats,
    scales,
    scales,
    offsets,
    functions,
)


# ---- the clock --------------------


def clock(random: Random, stamps: Column) -> Column:
    """Stamps with another period or start, or with no resolution at all."""
    count = len(stamps)
    kind = random.choice(("period", "period", "start", "start", "equal", "ulp", "coarse", "jump"))
    if kind == "period":
        factor = random.choice(PERIODS)
        return [stamp * factor for stamp in stamps]
    if kind == "start":
        start = random.choice(STARTS)
        return [stamp + start for stamp in stamps]
    if kind == "equal":
        return [stamps[0]] * count
    if kind == "ulp":
        level, values = random.choice((0.0, 1.0, 1.7e9)), []
        for _ in range(count):
            values.append(level)
            level = math.nextafter(level, math.inf)
        return values
    if kind == "coarse":
        digits = random.choice((0, 1, 2))
        return [round(stamp, digits) for stamp in stamps]
    at, size = random.randrange(count), random.choice((1e-12, 10.0, 1e9, 1e300))
    return [stamp + size * (k >= at) for k, stamp in enumerate(stamps)]


# ---- tables --------------------


def hostile_recording(random: Random, text: str) -> str:
    """The recording (CSV text) with one to three columns, its clock or its length replaced."""
    head, *rows = text.splitlines()
    columns = [
        list(column) for column in zip(*(map(float, r.split(",")) for r in rows), strict=True)
    ]
    for _ in range(random.randint(1, 3)):
        at = random.randrange(1, len(columns))
        choice = random.random()
        if choice < 0.15:
            columns[0] = clock(random, columns[0])
        elif choice < 0.25:  # the same signal twice
            columns[at] = [random.choice((1.0, 1.0, -1.0)) * v for v in random.choice(columns)]
        elif choice < 0.3:
            for k in range(1, len(columns)):
                columns[k] = zeros(Random("all"), columns[k])
        else:
            columns[at] = random.choice(CHANGES)(random, columns[at])
    if random.random() < 0.1:
        length = random.choice((1, 2, 3, 5, 12, 40))
        columns = [column[:length] for column in columns]
    lines = (",".join(map(repr, row)) for row in zip(*columns, strict=True))
    return "\n".join([head, *lines]) + "\n"


def wide_recording(random: Random) -> str:
    """A small file of many columns, or of many equal ones."""
    count, length = random.choice(((20, 80), (200, 40), (1000, 15), (3000, 5)))
    unit = random.choice(("v", "n", "rad"))
    head = ",".join(["time_s", *(f"c{k}_{unit}" for k in range(count))])
    values = [random.choice(("0", "1", f"{random.gauss(0, 1):.3g}")) for _ in range(count)]
    lines = []
    for k in range(length):
        if random.random() < 0.7:
            values = [f"{random.gauss(0, 1):.3g}" for _ in range(count)]
        lines.append(",".join([f"{0.01 * k:.3f}", *values]))
    return "\n".join([head, *lines]) + "\n"
