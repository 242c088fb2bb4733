"""The time base of a log: told apart before it is repaired, split at gaps, and brought to one even
base."""

from collections.abc import Callable

import numpy as np
import pytest

from pamid.base.arrays import Array
from pamid.intake.logs.conversion import hold, smooth
from pamid.intake.logs.stamps import IntArray, Rows, usable_rows
from pamid.intake.logs.time_base import (
    StampDiagnosis,
    diagnose_stamps,
    reconstructed_time_base,
)

T, N = 0.003, 12000
K = np.arange(N)


def motion(t: Array) -> Array:
    """9 Hz ringing on a 0.4 Hz motion, deg."""
    return np.asarray(20.0 * np.sin(2 * np.pi * 0.4 * t) + 2.0 * np.sin(2 * np.pi * 9.0 * t))


def arriving(t: Array, seed: int = 0, mean: float = 0.8e-3) -> Array:
    """When a host that is late by an exponential time writes samples taken at t."""
    late = np.random.default_rng(seed).exponential(mean, t.size)
    return np.asarray(np.maximum.accumulate(t + late) + 1e-9 * np.arange(t.size))


def jittering(seed: int = 0, spread: float = 0.8e-3) -> Array:
    return np.sort(K * T + np.random.default_rng(seed).normal(0.0, spread, N))


def judge(true: Array, stamps: Array, noise: float = 0.05) -> tuple[Rows, StampDiagnosis]:
    y = motion(true) + noise * np.random.default_rng(9).standard_normal(true.size)
    rows = usable_rows(stamps, [y], "log.csv: t")
    return rows, diagnose_stamps(rows, {"angle_deg": y[rows.keep]})


def sleeping() -> Array:
    """A loop on a PC that sleeps for a period each time: its errors add up."""
    return np.cumsum(T + np.random.default_rng(4).exponential(0.3e-3, N))


def one_sided() -> Array:
    """Samples taken late by a busy PC, with true stamps: one-sided as a host's latency is."""
    return arriving(K * T)


CASES: dict[str, tuple[Callable[[], tuple[Array, Array]], str]] = {
    "late": (lambda: (K * T, arriving(K * T)), "late-stamps"),
    "late, a clock 80 ppm fast": (lambda: (K * T, arriving(K * T * (1 + 8e-5))), "late-stamps"),
    "late, with pauses caught up": (lambda: (K * T, _paused()), "late-stamps"),
    "jitter": (lambda: (jittering(), jittering()), "jittered-sampling"),
    "jitter that is late only": (lambda: (one_sided(), one_sided()), "jittered-sampling"),
    "jitter that adds up": (lambda: (sleeping(), sleeping()), "jittered-sampling"),
    "half of each": (lambda: (K * T + 0.5 * (jittering() - K * T), jittering()), "undecided"),
    "ticks of 15.6 ms": (lambda: (K * T, np.floor(K * T / 0.015625) * 0.015625), "blocks"),
    "blocks of 50": (lambda: (K * T, (K // 50 + 1) * 50 * T), "blocks"),
    "stamps in whole ms": (lambda: (K / 300.0, np.round(K / 300.0, 3)), "rounded"),
    "even": (lambda: (K * T, K * T), "even"),
    "even since 1970": (lambda: (K * T, K * T + 1.7e9), "even"),
}


def _paused() -> Array:
    late = np.random.default_rng(0).exponential(0.8e-3, N)
    late[500::1500] += 0.15
    return np.asarray(np.maximum.accumulate(K * T + late) + 1e-9 * K)


@pytest.mark.parametrize("name", CASES)
def test_what_ails_the_stamps_is_told_from_the_data(name):
    make, state = CASES[name]
    rows, found = judge(*make())
    assert found.state == state, found.why
    assert found.cure == {"even": "none", "undecided": None, "jittered-sampling": state}.get(
        state, "late-stamps"
    )
    if state in ("late-stamps", "jittered-sampling"):
        assert "angle_deg" in found.why and f"{found.numbers['coefficient']:.2f}" in found.why
    if state not in ("jittered-sampling", "undecided"):
        period = {"stamps in whole ms": 1 / 300, "late, a clock 80 ppm fast": T * (1 + 8e-5)}.get(
            name, T
        )
        assert found.period == pytest.approx(period, rel=2e-5)


@pytest.mark.parametrize(
    ("truth", "right", "wrong", "reached"),
    [
        ("late", "late-stamps", "jittered-sampling", 0.003),
        ("jitter", "jittered-sampling", "late-stamps", 0.003),
    ],
)
def test_the_wrong_cure_is_thirty_times_worse(truth, right, wrong, reached):
    true, stamps = CASES[truth][0]()
    y = motion(true)
    rows = usable_rows(stamps, [y], "x")
    found = diagnose_stamps(rows, {"y": y})
    assert found.cure == right
    grid = K[100:-100] * T

    def error(cure):
        base = reconstructed_time_base(rows, found, cure, None)
        return float(np.sqrt(np.mean((smooth(base.instants, y, grid, T) - motion(grid)) ** 2)))

    assert error(right) < reached
    assert error(wrong) > 30.0 * error(right)


def test_gaps_split_and_are_not_bridged_while_a_pause_of_the_host_does_not_split():
    true = K * T + (K > 4000) * 2.34567 + (K > 8000) * 0.5
    for stamps in (true, arriving(true)):
        rows, found = judge(true, stamps)
        base = reconstructed_time_base(rows, found, found.cure or "none", 0.05)
        assert [piece.start for piece in base.pieces] == [0, 4001, 8001]
        assert base.instants - true == pytest.approx(0.0, abs=5e-5)
        assert next(r.count for r in base.repairs if r.what == "gaps") == 2
    rows, found = judge(K * T, _paused())
    base = reconstructed_time_base(rows, found, "late-stamps", 0.05)
    assert len(base.pieces) == 1 and not base.repairs


@pytest.mark.parametrize("late", [False, True])
def test_missing_samples_are_counted_and_their_place_found(late):
    there = np.random.default_rng(5).random(N) > 0.01
    there[[0, -1]] = True
    true = (K * T)[there]
    rows, found = judge(true, arriving(K * T)[there] if late else true)
    base = reconstructed_time_base(rows, found, found.cure or "none", None)
    lost = next(r.count for r in base.repairs if r.what == "samples-missing")
    assert lost == pytest.approx(N - there.sum(), abs=2 if late else 0)
    wrong = np.abs(base.instants - true) > 0.5 * T
    assert wrong.sum() <= (0.01 * N if late else 0)


def _repeated(share: float) -> IntArray:
    """Rows, some of which come twice."""
    again = np.flatnonzero(np.random.default_rng(7).random(N) < share)
    return np.sort(np.concatenate([K, again]))


REPEATED: dict[str, tuple[Callable[[], tuple[Array, Array]], str]] = {
    # name: (instants of the rows, stamps), the repair
    "readings of one instant": (
        lambda: (_repeated(0.01) * T, _repeated(0.01) * T),
        "stamps-repeated",
    ),
    "many readings of one instant": (
        lambda: (_repeated(0.05) * T, _repeated(0.05) * T),
        "stamps-repeated",
    ),
    "late, readings of one instant": (
        lambda: (_repeated(0.01) * T, arriving(K * T)[_repeated(0.01)]),
        "stamps-repeated",
    ),
    "late samples with the stamp of the one before": (
        lambda: (K * T, _as_before(arriving(K * T))),
        "stamps-shared",
    ),
    "samples faster than the clock": (
        lambda: (0.99 * K * T, np.floor(0.99 * K) * T),
        "stamps-shared",
    ),
}


def _as_before(stamps: Array) -> Array:
    at = np.flatnonzero(np.random.default_rng(8).random(N - 1) < 0.01) + 1
    stamps = stamps.copy()
    stamps[at] = stamps[at - 1]
    return stamps


@pytest.mark.parametrize("moving", [True, False])
@pytest.mark.parametrize("name", REPEATED)
def test_repeated_stamps_are_repaired_and_stretch_nothing(name, moving):
    true, stamps = REPEATED[name][0]()
    noise = 0.01 * np.random.default_rng(9).standard_normal(true.size)
    y = motion(true) + noise if moving else noise
    rows = usable_rows(stamps, [y], "log.csv: t")
    if moving or "faster" not in name:  # at rest nothing shows that samples lie between
        assert [r.what for r in rows.repairs] == [REPEATED[name][1]]
    base = reconstructed_time_base(rows, diagnose_stamps(rows, {"y": y}), "late-stamps", None)
    assert sum(repair.count for repair in base.repairs) <= 1
    assert base.instants[-1] - base.instants[0] == pytest.approx(true[-1] - true[0], abs=3.0 * T)
    error = base.instants - base.instants[0] - true[rows.keep] + true[rows.keep[0]]
    assert np.abs(error).max() < 3.0 * T


def test_rows_out_of_order_are_put_back_and_a_clock_set_back_splits():
    y, mixed = motion(K * T), K.copy()
    mixed[[50, 51]], mixed[[700, 702]] = mixed[[51, 50]], mixed[[702, 700]]
    rows = usable_rows(mixed * T, [y[mixed]], "x")
    assert (
        (rows.stamps == K * T).all()
        and rows.starts == (0,)
        and rows.repairs[0].what == "rows-out-of-order"
    )
    for back in (5.1, 0.0074):
        rows = usable_rows(K * T - (K >= 6000) * back, [y], "x")
        assert rows.starts == (0, 6000) and rows.repairs[0].what == "clock-set-back"
        base = reconstructed_time_base(rows, diagnose_stamps(rows, {"y": y}), "none", None)
        assert [(p.start, p.stop) for p in base.pieces] == [(0, 6000), (6000, N)]
        assert (np.diff(base.instants) > 0.0).all()


# ---- resampling --------------------


def test_a_line_at_310_hz_does_not_alias():
    t = np.arange(20000) * 1e-3
    base = np.arange(6600) * 3e-3
    course, line = np.sin(2 * np.pi * 0.4 * t), 0.35 * np.sin(2 * np.pi * 310 * t)
    ringing = 0.1 * np.sin(2 * np.pi * 9 * t)
    assert np.abs((course + line)[::3][:6600] - course[::3][:6600]).max() > 0.3
    inner = slice(50, -50)
    assert np.abs(smooth(t, course + line, base, 3e-3) - course[::3][:6600])[inner].max() < 1e-5
    both = smooth(t, course + ringing, base, 3e-3)
    assert np.abs(both - (course + ringing)[::3][:6600]).max() < 1e-5
    odd = np.arange(100, 5900) / 300.0  # 10 to 3: no whole number of samples
    assert (
        np.abs(smooth(t, course + line, odd, 1 / 300) - np.sin(2 * np.pi * 0.4 * odd)).max() < 1e-5
    )


def test_a_held_command_gets_no_value_it_never_had():
    levels = np.repeat(np.random.default_rng(0).uniform(-40, 40, 50), 100)
    t = np.arange(5000) * T
    assert (hold(t, levels, np.arange(15000) * 1e-3, 1e-3) == np.repeat(levels, 3)).all()
    assert (hold(t, levels, t, T) == levels).all()
    # a value that is written a little late belongs to its own sample, not to the next
    assert (hold(t + 1e-4, levels, t, T) == levels).all()


def test_samples_that_coincide_are_kept_to_the_bit():
    t = 17.3 + np.arange(1000) * T
    y = np.random.default_rng(0).standard_normal(1000)
    there = np.random.default_rng(1).random(1000) > 0.1
    there[[0, -1]] = True
    made = smooth(t[there], y[there], 17.3 + np.arange(1000) * T, T)
    assert (made[there] == y[there]).all() and np.isfinite(made).all()
