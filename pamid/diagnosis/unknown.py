"""An effect no file of the catalogue explains: which force is missing, against what, and a short formula for it.

The missing term is a latent value at the port, estimated window by window with the rig's states (moving horizon). A
sparse regression then describes it; the formula is a description, never the verdict.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pamid.assembly import Assembly
from pamid.attaching import Attachment
from pamid.diagnosis.contest import transferred
from pamid.diagnosis.tournament import Diagnosis
from pamid.effect import Effect, State
from pamid.equations import Expr, Number
from pamid.windows import Runner, Track, cut, estimate_start

Array = NDArray[np.float64]

SLICE_S = 0.06         # length of the windows over which the missing value is taken as constant
BAGS = 24
THRESHOLD = 0.08       # of the largest coefficient (regressors scaled to unit size)


class Latent(Effect):
    """A value that is simply missing: a constant per window, estimated and not explained."""

    name = "latent"
    family = "latent"
    kinds = ()
    states = (State("missing"),)

    def __init__(self, size: float) -> None:
        self.size = size

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> tuple[Number, dict[str, Number]]:
        return value + self.size * z.missing, {"missing": 0.0}


@dataclass(frozen=True)
class Missing:
    """A latent value at one port with the formula that describes it best; fit: share of its variance described."""

    port: str
    values: Array
    signals: dict[str, Array]
    names: list[str]
    weights: Array
    inclusion: Array
    fit: float


def describe_unknown(d: Diagnosis, *, seed: int = 0) -> dict[str, Any] | None:
    """Port, formula, variables, inclusion frequency and dissipation of the missing term; None if none is found.

    The term is placed at the port where it comes closest to a function of what that port offers.
    """
    rig = d.evidence.rig
    found = [m for name in rig.ports if rig.ports[name].signals for m in [_missing_at(d, name, seed)] if m is not None]
    if not found:
        return None
    best = max(found, key=lambda m: m.fit)
    kept = [i for i in np.argsort(-np.abs(best.weights)) if best.weights[i] != 0.0]
    size, unit = best.values.std(), rig.ports[best.port].unit
    formula = " ".join(f"{best.weights[i] * size:+.3g} {best.names[i]}" for i in kept)
    speed = best.signals.get("velocity")
    return {"port": rig.group_of(best.port), "formula": f"missing [{unit or '1'}] = {formula.lstrip('+')}",
            "variables": list(dict.fromkeys(w for i in kept for w in best.signals if w in best.names[i])),
            "inclusion": float(min(best.inclusion[i] for i in kept)), "described": best.fit,
            "dissipative": bool(speed is not None and np.mean(best.values * speed) < 0.0)}


def _missing_at(d: Diagnosis, port: str, seed: int) -> Missing | None:
    places = d.evidence.rig.ports[port].places
    values, signals = missing_value(d, port, places[0] if places else "")
    if len(values) < 40 or not values.std() > 0.0 or not signals:
        return None
    names, columns = regressors(signals)
    weights, inclusion = sparse_formula(columns, values, seed)
    if not weights.any():
        return None
    rest = values - columns @ weights * values.std()
    return Missing(port, values, signals, names, weights, inclusion, float(1.0 - rest.var() / values.var()))


def missing_value(d: Diagnosis, port: str, place: str) -> tuple[Array, dict[str, Array]]:
    """The latent value at a port over the held-out recordings, and the port's signals beside it (per slice)."""
    base, evidence = d.budget.baseline, d.evidence
    declared = evidence.rig.ports[port]
    size = d.budget.sizes.get((port, "value")) or declared.size.get("value", 1.0)
    latent = Attachment(Latent(0.1 * size), (port,), "latent", place)
    assembly = Assembly(evidence.rig, (latent,), background=True, sizes=d.budget.sizes, outputs=evidence.channels)
    passage = next(q for q in assembly.traced.passages if (q.port, q.place) == (port, place))
    extra = {f"at.{k}": v for k, v in passage.signals if isinstance(v, Expr) and k != "side"}
    program = assembly.program_with(extra)
    first = len(program.outputs) - len(extra)
    values, rows = [], []
    for track in evidence.tracks(assembly, held_out=True):
        runner = Runner(assembly, track, base.fit.stepping, whole=True)
        p = runner.parameters(transferred(assembly, base.assembly, base.fit.p))
        memory = runner.memory(p)
        place_of = assembly.program.states.index(next(s for s in assembly.program.states if "missing" in s))
        for window in cut(len(track), max(8, round(SLICE_S / track.period_s))):
            carried = memory.x[: runner.rig_states].copy()
            x, _, usable = estimate_start(runner, memory, window, p, 1.0 / evidence.noise, carried)
            if not usable:
                continue
            values.append(0.1 * size * x[place_of])
            rows.append(_signals(program, track, x, p, window.start, base.fit.stepping)[first:])
            runner.enter(memory, x)
            runner.run(memory, window, p, False)
    table = np.array(rows) if rows else np.zeros((0, len(extra)))
    return np.array(values), {k.removeprefix("at."): table[:, i] for i, k in enumerate(extra)}


def _signals(program: Any, track: Track, x: Array, p: Array, at: int, stepping: Any) -> Array:
    memory = program.memory(x, stepping=stepping, period_s=track.period_s)
    return program.run(memory, track.u[at : at + 1], p, period_s=track.period_s, stepping=stepping)[0][0]


def regressors(signals: dict[str, Array]) -> tuple[list[str], Array]:
    """Candidate terms of the formula, each scaled to unit size: powers, signs, products with a sign of motion."""
    names, columns = ["1"], [np.ones(len(next(iter(signals.values()))))]
    for name, x in signals.items():
        size = np.percentile(np.abs(x), 95.0)
        if size <= 0.0 or x.std() < 1e-6 * size:
            continue
        s = x / size
        names += [f"{name}/{size:.3g}", f"({name}/{size:.3g})^3", f"|{name}/{size:.3g}|"]
        columns += [s, s**3, np.abs(s)]
        if name == "velocity":
            names += [f"sign({name})", f"{name}|{name}|/{size:.3g}^2"]
            columns += [np.tanh(s / 0.05), s * np.abs(s)]
    return names, np.stack(columns, axis=1)


def sparse_formula(columns: Array, target: Array, seed: int) -> tuple[Array, Array]:
    """Sparse coefficients (target in its own standard deviations) and how often each term is kept over bags."""
    import pysindy

    y = (target / target.std())[:, None]
    random = np.random.default_rng(seed)

    def chosen(rows: NDArray[np.intp]) -> Array:
        optimizer = pysindy.STLSQ(threshold=THRESHOLD, alpha=1e-3 * len(rows), normalize_columns=False)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # an empty support is an answer here
            optimizer.fit(columns[rows], y[rows])
        return np.asarray(optimizer.coef_).ravel()

    everything = np.arange(len(target))
    blocks = np.array_split(everything, max(4, len(target) // 20))
    kept = [chosen(np.concatenate([blocks[k] for k in random.integers(0, len(blocks), len(blocks))])) != 0.0
            for _ in range(BAGS)]
    return chosen(everything), np.mean(kept, axis=0)
