"""An effect no file of the catalogue explains: which force is missing, against what, and a short
formula for it.

The missing term is the latent value that the smoother finds at the port. A sparse regression then
describes it; the formula is a description, never the verdict. The model's parameters are estimated
anew with it, for they have absorbed a part of it: where they move, term and model may grow
together and cancel. How much is missing is therefore reported with the parameters as fitted.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.base.csv_table import table_bytes
from pamid.base.metrics import rms
from pamid.base.parallel.jobs import Failed, Work, WorkerPool
from pamid.base.schemas import diagnosis_file as result
from pamid.base.units import display_unit, from_si, unit_label, with_unit
from pamid.diagnosis.pipeline import Diagnosis
from pamid.engine.symbolic.vocabulary import Expr
from pamid.estimation.smoother import (
    SMOOTHER_STEPS,
    ReplayedModel,
    Smoother,
    SmoothingResult,
    size_at,
)
from pamid.model.executable import Executable
from pamid.simulation.data_split import DataSplit
from pamid.simulation.windows import Runner, Window

MOST_TERMS = 4  # of a formula that is given
# sparse regression: bootstrap samples, coefficient set to zero (standard deviations of the target),
# ridge (share of the rows), speed over which a sign is smoothed (share of the usual speed)
BAGS, LEAST_COEFFICIENT, FORMULA_RIDGE, SMOOTH_SIGN = 24, 0.08, 1e-3, 0.05
FEWEST_SLICES = 40  # fewer are not described
DESCRIBED = 0.5  # share of the variance: what is described worse depends on the past
# ranges of size in which both directions are compared; ratio of the odd to the even part, or back
PARITY_BINS, PARITY_FACTOR = 8, 3.0
MISSING_ROWS = 4000  # of missing.csv at most

PASSING = "passing"  # in addition to the signals at a port: what passes there


@dataclass(frozen=True)
class Missing:
    """A latent value at a port with the formula that describes it best; fit: share of its
    variance described.

    values (n,), signals and time_s: an entry per slice, in the units people read (`units`, "value"
    among them); recording: its index among the recordings, as in residual.csv; amount: root mean
    square of what is missing to the model as fitted; passing: of what passes the port then, effects
    and the missing value included; both in the unit of the values.
    """

    port: str
    recording: NDArray[np.intp]
    time_s: Array
    values: Array
    signals: dict[str, Array]
    units: dict[str, str]
    names: list[str]
    weights: Array
    inclusion: Array
    fit: float
    amount: float
    passing: float


def find_missing(d: Diagnosis, *, pool: WorkerPool | None = None) -> Missing | None:
    """The missing term next to the causes, at the port with the largest latent evidence, or where a
    free form takes it up; of ports that the recordings cannot separate, at the port whose signals
    describe it best. None where nothing is missing, or no function of these signals
    fits."""
    located = d.left_at
    if located is None or located.most <= 0.0:
        return None
    names = [name for name in d.nameless_at if name in located.smoothers]
    if not names:
        return None
    base = located.smoothers[names[0]].base
    work = _Describing(d.evidence, base, d.seed, located.smoothers)
    candidates = [
        m
        for m in (pool or WorkerPool()).run(work, names)
        if m is not None and not isinstance(m, Failed)
    ]
    return max(candidates, key=lambda m: m.fit, default=None)


@dataclass(frozen=True, eq=False)
class _Describing(Work[str, Missing | None]):
    """Search for the missing input at a port, and for a formula of it."""

    what = "describing what is missing at"
    evidence: DataSplit
    base: ReplayedModel
    seed: int
    smoothers: dict[str, Smoother] = field(default_factory=dict, compare=False, repr=False)

    def __call__(self, item: str) -> Missing | None:
        smoother = self.smoothers.get(item) or Smoother(self.evidence, self.base, (item,))
        port = smoother.base.assembly.rig.ports[smoother.ports[0]]
        best, rough = smoother.best, smoother.rough
        recording, time_s, values, signals = missing_value(
            smoother, smoother.smoothed(best, best.size, best.time_s, SMOOTHER_STEPS)
        )
        signals.pop(PASSING)
        if len(values) < FEWEST_SLICES or not values.std() > 0.0 or not signals:
            return None
        units = {k: unit_label(display_unit(port.unit_of(k))) for k in ("value", *signals)}
        values = from_si(values, units["value"])
        signals = {k: from_si(x, units[k]) for k, x in signals.items()}
        names, columns = regressors(signals, units)
        weights, inclusion = sparse_formula(columns, values, self.seed)
        if not weights.any():
            return None
        rest = values - columns @ weights * values.std()
        *_, lacking, reestimated = missing_value(
            smoother,
            smoother.smoothed(rough, rough.size, rough.time_s, SMOOTHER_STEPS, moving=False),
        )
        return Missing(
            smoother.ports[0],
            recording,
            time_s,
            values,
            signals,
            units,
            names,
            weights,
            inclusion,
            float(1.0 - rest.var() / values.var()),
            rms(from_si(lacking, units["value"])),
            rms(from_si(reestimated[PASSING], units["value"])),
        )


def described(d: Diagnosis, best: Missing | None) -> result.Unknown | None:
    """Port, formula, nature and free forms of what remains; None if the smoother finds
    nothing."""
    located, group_of = d.left_at, d.evidence.rig.group_of
    if located is None or located.most <= 0.0:
        return None
    forms = tuple(
        result.FamilyForm(
            effect=f.attachment.label,
            family=f.family,
            port=f.port,
            known_by=f.known_by,
            removes=f.removes,
            shrinkage=share,
            low=low,
            high=high,
            curve=f.curve,
        )
        for f in (d.answer.free_forms if d.answer else ())
        for share, low, high in [d.comparison.shrinkage(f.model)]
    )
    if best is None:
        return result.Unknown(
            port=group_of(d.nameless_at[0]),
            formula="",
            variables=(),
            inclusion=0.0,
            described=0.0,
            dissipative=False,
            parity="none",
            memory=False,
            free_forms=forms,
        )
    terms = [i for i in np.argsort(-np.abs(best.weights)) if best.weights[i] != 0.0]
    size, unit = best.values.std(), best.units["value"]
    formula = " ".join(f"{best.weights[i] * size:+.3g} {best.names[i]}" for i in terms)
    speed = best.signals.get("velocity")
    return result.Unknown(
        port=group_of(best.port),
        # a longer formula describes the points, and nothing that a reader would recognise
        formula=f"missing [{unit or '1'}] = {formula.lstrip('+')}"
        if len(terms) <= MOST_TERMS
        else "",
        variables=tuple(
            dict.fromkeys(w for i in terms for w in best.signals if w in best.names[i])
        ),
        inclusion=float(min(best.inclusion[i] for i in terms)),
        described=best.fit,
        dissipative=bool(speed is not None and np.mean(best.values * speed) < 0.0),
        parity=parity(best),
        memory=bool(best.fit < DESCRIBED),
        free_forms=forms,
    )


def missing_csv(m: Missing) -> bytes:
    """missing.csv: time_s, recording, the port's signals and the missing value, every k-th slice,
    so that they are not too many rows."""
    step = -(-len(m.values) // MISSING_ROWS)
    columns = {
        "time_s": m.time_s,
        "recording": m.recording,
        **{with_unit(name, m.units[name]): x for name, x in m.signals.items()},
        with_unit("missing", m.units["value"]): m.values,
    }
    rows = np.stack([x.astype(np.float64) for x in columns.values()], axis=1)[::step]
    return table_bytes(list(columns), rows, ["%.9g"] * len(columns))


def missing_value(
    smoother: Smoother, smoothed: SmoothingResult
) -> tuple[NDArray[np.intp], Array, Array, dict[str, Array]]:
    """Recording (index), time (s), missing value (SI) at the first place of a port over the
    held-out recordings, a value per slice, and the means over it of the port's signals (SI), and of
    what passes in the end, with all that acts there."""
    assembly, port = smoother.assembly, smoother.ports[0]
    passage = next(q for q in assembly.traced.passages if q.port == port)
    extra = {f"at.{k}": v for k, v in passage.signals if isinstance(v, Expr) and k != "side"}
    extra[f"at.{PASSING}"] = passage.result
    program = assembly.program_with(extra)
    first = len(program.outputs) - len(extra)
    rows, values, times, numbers = [], [], [], []
    recordings = smoother.evidence.recordings
    p = smoother.parameters(smoothed.s)
    for sliced, states, span in zip(
        smoother.tracks, smoothed.x, smoother.evidence.held_out, strict=True
    ):
        track = sliced.runner.track
        values.append(size_at(smoother.base.assembly, port) * states[:, smoother.missing[0]])
        rows += [
            _signals(program, sliced.runner, x, sliced.runner.parameters(p), over)[first:]
            for x, over in zip(states, sliced.slices, strict=True)
        ]
        times.append(
            np.array([(track.first + over.start) * track.period_s for over in sliced.slices])
        )
        index = next(i for i, r in enumerate(recordings) if r is span.recording)
        numbers.append(np.full(len(sliced.slices), index))
    table = np.array(rows)
    return (
        np.concatenate(numbers),
        np.concatenate(times),
        np.concatenate(values),
        {k.removeprefix("at."): table[:, i] for i, k in enumerate(extra)},
    )


def parity(m: Missing) -> str:
    """Parity of the missing value as a function of its signal: "odd", "even" or "mixed"."""
    name = "velocity" if "velocity" in m.signals else next(iter(m.signals))
    x, y = m.signals[name] - np.median(m.signals[name]), m.values - m.values.mean()
    # f(x) = odd + even part, (f(x) -+ f(-x)) / 2, in bins of |x| that were visited both ways
    bins = np.quantile(np.abs(x), np.linspace(0.0, 1.0, PARITY_BINS + 1))
    place = np.clip(np.searchsorted(bins, np.abs(x), side="right") - 1, 0, PARITY_BINS - 1)
    odd = even = 0.0
    for k in range(PARITY_BINS):
        up, down = y[(place == k) & (x > 0)], y[(place == k) & (x < 0)]
        if len(up) > 2 and len(down) > 2:
            odd += (0.5 * (up.mean() - down.mean())) ** 2
            even += (0.5 * (up.mean() + down.mean())) ** 2
    if odd > PARITY_FACTOR * even:
        return "odd"
    return "even" if even > PARITY_FACTOR * odd else "mixed"


def _signals(program: Executable, runner: Runner, x: Array, p: Array, over: Window) -> Array:
    """Mean of every output over a slice that begins at state x."""
    track = runner.track
    memory = program.memory(x, stepping=runner.stepping, period_s=track.period_s)
    return program.run(
        memory, track.inputs.part(over.start, over.stop), p, stepping=runner.stepping
    )[0].mean(axis=0)


def regressors(signals: dict[str, Array], units: dict[str, str]) -> tuple[list[str], Array]:
    """Candidate terms of the formula, each scaled to unit size: powers, signs, products with a sign
    of motion."""
    names, columns = ["1"], [np.ones(len(next(iter(signals.values()))))]
    for name, x in signals.items():
        size = np.percentile(np.abs(x), 95.0)
        if size <= 0.0 or x.std() < 1e-6 * size:
            continue
        s = x / size
        scaled = f"{name}/({size:.3g} {units[name]})" if units[name] else f"{name}/{size:.3g}"
        names += [scaled, f"({scaled})^3"]
        columns += [s, s**3]
        if x.min() < 0.0 < x.max():
            names.append(f"|{scaled}|")
            columns.append(np.abs(s))
        if name == "velocity":
            names += [f"sign({name})", f"{scaled} |{scaled}|"]
            # smooth below a share of the usual speed, where the sign is that of the noise
            columns += [np.tanh(s / SMOOTH_SIGN), s * np.abs(s)]
    return names, np.stack(columns, axis=1)


def sparse_formula(columns: Array, target: Array, seed: int) -> tuple[Array, Array]:
    """Sparse coefficients (target in its standard deviations) and how often each term is kept
    over bags: sequentially thresholded least squares (Brunton, Proctor and Kutz 2016, PNAS
    113(15)), bagged (Fasel, Kutz, Brunton and Brunton 2022, Proc. R. Soc. A 478)."""
    import pysindy

    y = (target / target.std())[:, None]
    random = np.random.default_rng(seed)

    def chosen(rows: NDArray[np.intp]) -> Array:
        optimizer = pysindy.STLSQ(
            threshold=LEAST_COEFFICIENT, alpha=FORMULA_RIDGE * len(rows), normalize_columns=False
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # an empty support is an answer here
            optimizer.fit(columns[rows], y[rows])
        return np.asarray(optimizer.coef_).ravel()

    everything = np.arange(len(target))
    # drawn in blocks of about twenty slices in a row: neighbours are alike
    blocks = np.array_split(everything, max(4, len(target) // 20))
    terms = [
        chosen(np.concatenate([blocks[k] for k in random.integers(0, len(blocks), len(blocks))]))
        != 0.0
        for _ in range(BAGS)
    ]
    return chosen(everything), np.mean(terms, axis=0)
