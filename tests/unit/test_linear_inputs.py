"""Inputs that lead in a straight line from one sample to the next: against closed solutions."""

from pathlib import Path

import numpy as np
import pytest
from compiled import PERIOD_S, begin, parameter

from pamid.base.arrays import Array
from pamid.base.errors import FileError
from pamid.engine.program import Program, Stepping, build_program
from pamid.engine.sampled_inputs import SampledInputs
from pamid.engine.symbolic.expression import symbol
from pamid.engine.symbolic.memory_cells import expand_memory
from pamid.engine.symbolic.vocabulary import Expr, delay, lag, play
from pamid.intake.checks.conformance import (
    NULL_TOLERANCE,
    SAME_SLOPE,
    EveryPortRig,
    null_error,
    sensitivity_error,
)
from pamid.model.assembly import Assembly
from pamid.model.attachment import attachments
from pamid.model.between_samples import as_recorded
from pamid.model.registry import effects, rig_named
from pamid.recording.recording import Recording, recording_of

CART = str(Path(__file__).resolve().parents[2] / "data" / "rigs" / "cart.py")
H, N = PERIOD_S, 40
U = np.random.default_rng(3).standard_normal(N)
u, x, a = symbol("input", "u"), symbol("state", "x"), parameter("a")
STEPPINGS = [Stepping(), Stepping(3), Stepping(1, implicit=True), Stepping(3, implicit=True)]


def made(rates: dict[str, Expr], outputs: dict[str, Expr], linear: bool = True) -> Program:
    moving = ("u",) if linear else ()
    return build_program(
        expand_memory(rates, outputs, (), moving), ("u",), ("a",), tuple(outputs), None, moving
    )


def run(p: Program, value: float, start: float, stepping: Stepping, sens: bool = False) -> Array:
    memory = begin(p, [start], stepping, 1)
    y, J, bad = p.run(
        memory,
        SampledInputs(U[:, None], H),
        np.array([value]),
        stepping=stepping,
        columns=np.array([0]) if sens else None,
    )
    assert bad == -1
    return J[:, :, 0] if sens else y


def lagged(rate: float, start: float) -> Array:
    """dx/dt = rate (u - x), solved for u in straight lines."""
    out, decay = [start], np.exp(-rate * H)
    for before, after in zip(U[:-1], U[1:], strict=True):
        slope = (after - before) / H
        out.append(after - slope / rate + (out[-1] - before + slope / rate) * decay)
    return np.array(out)


@pytest.mark.parametrize("stepping", STEPPINGS)
def test_the_integrator_takes_the_straight_line_at_every_stage(stepping):
    """Errors fall with the order of the method; a held input is off by half a sample."""
    model, rate = made({"x": a * (u - x)}, {"y": x}), 0.3 / H
    exact = lagged(rate, 0.2)
    doubled = stepping.doubled()
    off, less = (np.abs(run(model, rate, 0.2, s)[:, 0] - exact).max() for s in (stepping, doubled))
    held = run(made({"x": a * (u - x)}, {"y": x}, False), rate, 0.2, stepping)[:, 0]
    assert off < 0.05 * np.abs(held - exact).max()
    assert less < off / (3.0 if stepping.implicit else 12.0)


@pytest.mark.parametrize("stepping", STEPPINGS)
@pytest.mark.parametrize("kind", ["rate", "lag", "delay", "play"])
def test_sensitivities_are_exact(kind, stepping):
    enters = {
        "rate": a * u,
        "lag": lag(u, a),
        "delay": delay(u, a, 10.0 * H),
        "play": play(u, a),
    }[kind]
    model = made({"x": (enters - x) / (3.0 * H)}, {"y": x, "now": enters})
    value = 1.37 * H if kind in ("lag", "delay") else 0.31
    step = 1e-6 * value
    apart = (run(model, value + step, 0.2, stepping) - run(model, value - step, 0.2, stepping)) / (
        2.0 * step
    )
    exact = run(model, value, 0.2, stepping, sens=True)
    assert np.abs(exact - apart).max() < 1e-5 * np.abs(apart).max()


@pytest.mark.parametrize("seconds", [0.0, 0.4 * H, H, 1.7 * H, 6.0 * H])
def test_a_delayed_line_is_the_line_delayed(seconds):
    stepping = Stepping(10)
    late = delay(u, a, 10.0 * H)
    y = run(made({"x": late}, {"y": late, "x": x}), seconds, 0.0, stepping)
    t = np.arange(N) * H
    fine = np.linspace(0.0, t[-1], 100 * (N - 1) + 1)
    then = np.interp(fine - seconds, t, U)
    area = np.concatenate([[0.0], np.cumsum(0.5 * (then[1:] + then[:-1]))])[::100] * H / 100.0
    assert y[:, 0] == pytest.approx(np.interp(t - seconds, t, U), abs=1e-12)
    assert np.abs(y[:, 1] - area).max() < 1e-12 * N


def cart(way: str) -> tuple[Assembly, Recording]:
    recording = recorded(way)
    return Assembly(as_recorded(rig_named(CART), [recording])), recording


def recorded(way: str, samples: int = 900) -> Recording:
    random = np.random.default_rng(1)
    t = 0.004 * np.arange(samples)
    columns = {"force_n": random.standard_normal(samples), "position_m": np.sin(t)}
    return recording_of(t, columns, {"between": {"force_n": way}} if way else {})


def test_a_recording_says_it_for_its_rig():
    rig = rig_named(CART)
    assert as_recorded(rig, [recorded("")]) is rig and as_recorded(rig, [recorded("held")]) is rig
    assert cart("linear")[0].program.linear == (0,) and cart("held")[0].program.linear == ()
    with pytest.raises(FileError, match="force_n is 'linear' in"):
        as_recorded(rig, [recorded("linear"), recorded("held")])
    with pytest.raises(FileError, match="stepwise"):
        recorded("stepwise")


class LinearBench(EveryPortRig):
    """The small machine with a port of every kind, its command linear between samples."""

    name = "linear-bench"
    between = {"command": "linear"}


@pytest.mark.parametrize("spec", ["dead-time", "first-order-lag", "dead-zone", "two-mass"])
def test_effects_vanish_and_slope_exactly_there_too(spec):
    rig = LinearBench()
    fit = [a for a in attachments(rig, effects().values()) if a.effect.name == spec]
    attachment = min(fit, key=lambda a: a.ports != ("command",))
    assert null_error(rig, attachment, draws=1) < NULL_TOLERANCE
    assert sensitivity_error(rig, attachment) < SAME_SLOPE
