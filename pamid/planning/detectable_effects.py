"""Detectability of effects in an experiment, before anything is measured.

The experiment is run on the rig of the data sheet, without any effect but with the sensors' noise,
and fitted. With the weighted rows r of that fit (`pamid.estimation.linear_rows`), an effect e of
some size changes them by D_e; what parameters, background and window starts could change as well is
projected out (P). To first order

    z_e = |P D_e|

is the size of the effect in standard errors: the square root of twice the log likelihood ratio that
the experiment would give for it. Over the n samples of a channel c it raises the error of the
refitted model from the noise floor by the factor

    v_ec = sqrt(1 + |P D_e|_c^2 / n)

its visibility, which has to exceed the margin that a diagnosis calls no gap. Beside another effect
f, which may take any size and the derivatives T_f of its parameters,

    z_(e|f) = min over a, b of |P (D_e - a D_f - T_f b)|

and f is confused with e where little of z_e is left. Silvey (1980), Optimal Design, for information
about some parameters beside others; Atkinson and Fedorov (1975), Biometrika 62:57, for that about
models.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pamid.base.progress import Progress, silent
from pamid.diagnosis.candidate_model import transferred
from pamid.diagnosis.settings import DEFAULT
from pamid.estimation.grey_box import model_with
from pamid.estimation.linear_rows import LinearRows, linear_rows, orthonormal_span
from pamid.estimation.observed_sizes import observed_sizes
from pamid.estimation.problem import Fit, Problem, free_parameters
from pamid.estimation.robust_fit import fit_robustly
from pamid.model.attachment import Attachment, attachments
from pamid.model.bound_parameter import Bound, Sizes
from pamid.model.effect import Effect
from pamid.parallel.jobs import Failed, Work, WorkerPool
from pamid.simulation.data_split import DataSplit

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PowerSettings:
    """sizes: multiples of an effect's usual size at which the experiment is tried, 1 among them;
    margin: by how much more than the noise floor the error has to be (a diagnosis calls less no
    gap); sure: standard errors below which nothing is said of an effect, nor two told apart; alike:
    share of an effect that is left where another is taken for it, as of look-alikes; rows:
    residuals at most, thinned evenly; finer: times that the steps are halved where an effect is too
    stiff."""

    sizes: tuple[float, ...] = (0.1, 0.3, 1.0, 3.0)
    margin: float = DEFAULT.floor_margin
    sure: float = 3.0
    alike: float = DEFAULT.alike_share
    rows: int = 6000
    finer: int = 3


USUAL = PowerSettings()


@dataclass(frozen=True, eq=False)
class Amount:
    """The parameter that says how large an effect is: its name and unit outside, and its usual
    value there."""

    name: str
    unit: str
    usual: float


@dataclass(frozen=True, eq=False)
class EffectPower:
    """Detectability of an effect in an experiment. errors: its size in standard errors at every one
    of `Power.sizes`; visible: error of the refitted model over the noise floor there, in the worst
    channel; by_channel: the same at its usual size if that sensor were the only one; confused:
    effects of other families that would be taken for it at its usual size, the likeliest first;
    failed: why nothing can be said."""

    effect: str
    family: str
    port: str
    amount: Amount | None
    errors: tuple[float, ...] = ()
    visible: tuple[float, ...] = ()
    by_channel: dict[str, float] | None = None
    confused: tuple[str, ...] = ()
    failed: str = ""


@dataclass(frozen=True, eq=False)
class Power:
    """sizes: multiples of the usual one at which effects were tried; seen: visibility from which
    one shows; channels: sensors of the experiment; seconds: its length."""

    effects: tuple[EffectPower, ...]
    sizes: tuple[float, ...]
    channels: tuple[str, ...]
    seen: float
    seconds: float

    def least(self, effect_power: EffectPower) -> float | None:
        """The smallest multiple of the usual size that shows: by a power law between the sizes that
        were tried, in proportion below the smallest; None where the largest does not."""
        r = np.sqrt(np.maximum(np.square(effect_power.visible) - 1.0, 1e-18))
        wanted = np.sqrt(self.seen**2 - 1.0)
        above = np.flatnonzero(r >= wanted)
        if not len(above):
            return None
        i = int(above[0])
        if i == 0:
            return float(self.sizes[0] * wanted / r[0])
        return float(
            np.exp(
                np.interp(
                    np.log(wanted), np.log(r[i - 1 : i + 1]), np.log(self.sizes[i - 1 : i + 1])
                )
            )
        )

    @property
    def showing(self) -> tuple[EffectPower, ...]:
        """Those that show at their usual size."""
        usual = self.sizes.index(1.0)
        return tuple(e for e in self.effects if e.visible and e.visible[usual] >= self.seen)


def experiment_power(
    evidence: DataSplit,
    catalogue: dict[str, type[Effect]],
    *,
    pool: WorkerPool | None = None,
    progress: Progress = silent,
    settings: PowerSettings = USUAL,
) -> Power:
    """Detectability of every effect in the fitted part of the data: recordings of a rig that has
    none of them. Whatever can act at a port of the rig is tried."""
    pool = pool or WorkerPool()
    progress("fitting the experiment without any effect")
    sizes = observed_sizes(evidence)
    assembly = model_with(evidence, (), sizes)
    tracks = evidence.tracks(assembly)
    base = fit_robustly(Problem(assembly, tracks, free_parameters(assembly, tracks)))
    ground = linearised(base, base.problem, base.p, settings)
    work = _Responding(evidence, base, sizes, settings, ground.away)
    candidates = attachments(evidence.rig, catalogue.values())
    powers = pool.run(work, candidates, progress)
    responses = {
        a.label: r.columns
        for a, r in zip(candidates, powers, strict=True)
        if not isinstance(r, Failed)
    }
    progress("comparing effects")
    everything = _Projected.of(ground, np.ones(len(ground.away), bool))
    channels = evidence.channels
    own = {c: ground.channel == k for k, c in enumerate(channels)}
    only = {c: _Projected.of(ground, rows | (ground.channel < 0)) for c, rows in own.items()}
    samples = {c: float(sum(t.seen[k] * len(t) for t in tracks)) for k, c in enumerate(channels)}
    usual = settings.sizes.index(1.0)
    inner = _inner(everything, responses, usual, len(settings.sizes))
    effects = []
    for a, r in zip(candidates, powers, strict=True):
        about = (a.label, a.family(evidence.rig), a.group(evidence.rig))
        if isinstance(r, Failed):
            effects.append(EffectPower(*about, None, failed=r.why))
            continue
        if a.label not in inner:
            why = "the rig with it becomes unstable"
            effects.append(EffectPower(*about, r.amount, failed=why))
            continue
        tried = [everything(r.columns[:, k]) for k in range(len(settings.sizes))]
        effects.append(
            EffectPower(
                *about,
                r.amount,
                tuple(float(np.linalg.norm(x)) for x in tried),
                tuple(max(visibility(x[own[c]], samples[c]) for c in channels) for x in tried),
                {
                    c: visibility(q(r.columns[:, usual])[own[c][q.counted]], samples[c])
                    for c, q in only.items()
                },
                _confused(evidence, candidates, inner, a, settings),
            )
        )
    seconds = sum(len(t) * t.period_s for t in tracks)
    return Power(tuple(effects), settings.sizes, channels, 1.0 + settings.margin, float(seconds))


def visibility(changed: Array, samples: float) -> float:
    """Error of the refitted model over the noise floor: see the head of the module."""
    return float(np.sqrt(1.0 + changed @ changed / max(samples, 1.0)))


def linearised(
    base: Fit,
    problem: Problem,
    p: Array,
    settings: PowerSettings,
    *,
    derivatives: bool = True,
) -> LinearRows:
    """The rows of a model at p, beside a fit; with finer steps where an effect is too stiff for
    those of the rig."""
    at = replace(base, problem=problem, p=p)
    for _ in range(settings.finer):
        with np.errstate(over="ignore", invalid="ignore"):
            linear = linear_rows(at, settings.rows, derivatives=derivatives)
        if linear.finite:
            break
        at = replace(at, stepping=at.stepping.doubled())
    return linear


@dataclass(frozen=True, eq=False)
class _Change:
    """Change of the rows by an effect, a column per size, then one per parameter of its own."""

    columns: Array
    amount: Amount | None


@dataclass(frozen=True, eq=False)
class _Responding(Work[Attachment, _Change]):
    """ground: the rows of the fit."""

    what = "response to"
    evidence: DataSplit
    base: Fit
    sizes: Sizes
    settings: PowerSettings
    ground: Array

    def __call__(self, item: Attachment) -> _Change:
        assembly = model_with(self.evidence, (item,), self.sizes)
        own = [b for b in assembly.parameters if b.owner == item.label]
        # derivatives by the effect's own parameters are all that is asked of it, those by the rig's
        # are the ground's: of an arm, or of a simulation that is stepped, they cost most by far
        fitted = frozenset(b.key for b in own if b.fitted)
        assembly = replace(assembly, sensitive=fitted)
        tracks = self.evidence.tracks(assembly)
        free = free_parameters(assembly, tracks)
        mine = tuple(i for i in free if assembly.parameters[i].key in fitted)
        problem = Problem(assembly, tracks, mine)
        columns, tangents = list[Array](), np.zeros((len(self.ground), 0))
        for size in self.settings.sizes:
            p = transferred(assembly, (self.base.problem.assembly, self.base.p))
            for b in own:
                if b.null is not None:
                    usual = b.null + size * (b.value - b.null)
                    p[assembly.keys[b.key]] = min(max(usual, b.low), b.high)
            at_usual = size == 1.0
            rows = linearised(self.base, problem, p, self.settings, derivatives=at_usual)
            columns.append(self._beside(rows.away, len(mine)) - self.ground)
            if at_usual:
                tangents = np.zeros((len(self.ground), len(mine)))
                common = len(rows.away) - len(mine)
                tangents[:common] = rows.by_parameters[:common]
        return _Change(np.column_stack([*columns, tangents]), _amount(own))

    def _beside(self, away: Array, own: int) -> Array:
        """Rows that the model without the effect has, too: not those of the effect's data sheet,
        which are the last, but those of the rig's, which stays as it was fitted."""
        common = len(away) - own
        return np.concatenate([away[:common], self.ground[common:]])

    def name(self, item: Attachment) -> str:
        return item.label


def _amount(own: Sequence[Bound]) -> Amount | None:
    """The first of an effect's parameters at whose null it vanishes."""
    first = next((b for b in own if b.null is not None), None)
    return Amount(first.name, first.unit, first.value / first.factor) if first else None


@dataclass(frozen=True, eq=False)
class _Projected:
    """Rows that count, and an orthonormal base of what parameters and starts can change in them."""

    counted: NDArray[np.bool_]
    spanned: Array

    @classmethod
    def of(cls, ground: LinearRows, counted: NDArray[np.bool_]) -> _Projected:
        columns = np.column_stack([ground.by_parameters, ground.by_starts])[counted]
        return cls(counted, orthonormal_span(columns))

    def __call__(self, columns: Array) -> Array:
        own = columns[self.counted]
        return np.asarray(own - self.spanned @ (self.spanned.T @ own))


def _inner(
    projected: _Projected, responses: dict[str, Array], usual: int, count: int
) -> dict[str, tuple[Array, Array]]:
    """Of every effect that stays finite: its response at the usual size, projected, and an
    orthonormal base of it with the derivatives by its own parameters."""
    spans = {}
    for label, columns in responses.items():
        with np.errstate(over="ignore", invalid="ignore"):  # slopes of what runs away may be large
            size = np.square(columns).sum()
        if not np.isfinite(size):
            continue
        own = projected(np.column_stack([columns[:, usual], columns[:, count:]]))
        spans[label] = own[:, 0], orthonormal_span(own)
    return spans


def _confused(
    evidence: DataSplit,
    candidates: Sequence[Attachment],
    inner: dict[str, tuple[Array, Array]],
    a: Attachment,
    settings: PowerSettings,
) -> tuple[str, ...]:
    """Effects of other families that leave little of this one, the least first."""
    response = inner[a.label][0]
    whole = float(np.linalg.norm(response))
    if whole < settings.sure:
        return ()
    left = {
        other.label: float(np.linalg.norm(response - base @ (base.T @ response)))
        for other in candidates
        if other.label in inner and other.family(evidence.rig) != a.family(evidence.rig)
        for base in [inner[other.label][1]]
    }
    least = max(settings.sure, settings.alike * whole)
    alike = [k for k, v in left.items() if v < least]
    return tuple(sorted(alike, key=lambda k: left[k]))
