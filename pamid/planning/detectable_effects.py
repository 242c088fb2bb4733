"""What an experiment would show, before anything is measured.

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
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pamid.base.progress import Progress, silent
from pamid.diagnosis.candidate_model import transferred
from pamid.estimation.grey_box import model_with
from pamid.estimation.linear_rows import LinearRows, linear_rows
from pamid.estimation.multiple_shooting import fit_robustly
from pamid.estimation.observed_sizes import observed_sizes
from pamid.estimation.problem import Fit, Problem, free_parameters
from pamid.model.assembly import Assembly
from pamid.model.attachment import Attachment, attachments
from pamid.model.bound_parameter import Bound, Sizes
from pamid.model.effect import Effect
from pamid.parallel.jobs import Failed, Work, WorkerPool
from pamid.parallel.result_store import Plain
from pamid.simulation.data_split import DataSplit

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PowerSettings:
    """sizes: multiples of an effect's usual size at which the experiment is tried, 1 among them;
    margin: by how much more than the noise floor the error has to be (a diagnosis calls less no
    gap: `gap_margin`); sure: standard errors below which nothing is said of an effect, nor two told
    apart; alike: share of an effect that is left where another is taken for it (`alike_share` of
    the look-alikes); rows: residuals at most, thinned evenly; finer: times that the steps are
    halved where an effect is too stiff."""

    sizes: tuple[float, ...] = (0.1, 0.3, 1.0, 3.0)
    margin: float = 0.10
    sure: float = 3.0
    alike: float = 0.25
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
    """What an experiment would show of an effect. errors: its size in standard errors at every one
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

    def least(self, one: EffectPower) -> float | None:
        """The smallest multiple of the usual size that shows: by a power law between the sizes that
        were tried, in proportion below the smallest; None where the largest does not."""
        r = np.sqrt(np.maximum(np.square(one.visible) - 1.0, 1e-18))
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
    """What the fitted part of the evidence would show of every effect: recordings of a rig that has
    none of them. Whatever can act at a port of the rig is tried."""
    pool = pool or WorkerPool()
    progress("fitting the experiment without any effect")
    sizes = observed_sizes(evidence)
    assembly = model_with(evidence, (), sizes)
    tracks = evidence.tracks(assembly)
    base = fit_robustly(Problem(assembly, tracks, free_parameters(assembly, tracks)))
    work = _Responding(evidence, base, sizes, settings)
    candidates = attachments(evidence.rig, catalogue.values())
    found = pool.run(work, candidates, progress)
    responses = {
        a.label: r for a, r in zip(candidates, found, strict=True) if not isinstance(r, Failed)
    }
    progress("comparing effects")
    ground = work.rows(assembly, base.p)
    everything = _Projected.of(ground, np.ones(len(ground.away), bool))
    channels = evidence.channels
    of = _channel_of_rows(base, ground, settings)
    own = {c: of == k for k, c in enumerate(channels)}
    only = {c: _Projected.of(ground, rows | (of < 0)) for c, rows in own.items()}
    samples = {c: float(sum(t.seen[k] * len(t) for t in tracks)) for k, c in enumerate(channels)}
    usual = settings.sizes.index(1.0)
    inner = _inner(everything, responses, usual, len(settings.sizes))
    effects = []
    for a, r in zip(candidates, found, strict=True):
        about = (
            a.label,
            a.family(evidence.rig),
            a.group(evidence.rig),
            _amount(evidence, a, sizes),
        )
        if isinstance(r, Failed) or a.label not in inner:
            why = r.why if isinstance(r, Failed) else "the rig with it becomes unstable"
            effects.append(EffectPower(*about, failed=why))
            continue
        tried = [everything(r[:, k]) for k in range(len(settings.sizes))]
        effects.append(
            EffectPower(
                *about,
                tuple(float(np.linalg.norm(x)) for x in tried),
                tuple(max(visibility(x[own[c]], samples[c]) for c in channels) for x in tried),
                {
                    c: visibility(q(r[:, usual])[own[c][q.counted]], samples[c])
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


@dataclass(frozen=True, eq=False)
class _Responding(Work[Attachment, Array]):
    """What an effect changes in the rows: a column per size, then one per parameter of its own."""

    what = "response to"
    evidence: DataSplit
    base: Fit
    sizes: Sizes
    settings: PowerSettings

    def rows(self, assembly: Assembly, p: Array) -> LinearRows:
        """With finer steps where an effect is too stiff for those of the rig."""
        tracks = self.evidence.tracks(assembly)
        problem = Problem(assembly, tracks, free_parameters(assembly, tracks))
        b, stepping = self.base, self.base.stepping
        for _ in range(self.settings.finer):
            with np.errstate(over="ignore", invalid="ignore"):
                found = linear_rows(
                    problem,
                    p,
                    b.starts,
                    b.weights,
                    b.continuity,
                    stepping,
                    self.settings.rows,
                )
            if found.finite:
                break
            stepping = stepping.doubled()
        return found

    def __call__(self, item: Attachment) -> Plain:
        assembly = model_with(self.evidence, (item,), self.sizes)
        ground = self.rows(self.base.problem.assembly, self.base.p)
        own = [b for b in assembly.parameters if b.owner == item.label]
        columns, tangents = list[Array](), np.zeros((len(ground.away), 0))
        for size in self.settings.sizes:
            p = transferred(assembly, (self.base.problem.assembly, self.base.p))
            for b in _amounts(own):
                usual = b.null + size * (b.value - b.null) if b.null is not None else b.value
                p[assembly.keys[b.key]] = min(max(usual, b.low), b.high)
            rows = self.rows(assembly, p)
            kept, mine = _split(rows, assembly, self.base.problem, item.label)
            columns.append(rows.away[kept] - ground.away)
            if size == 1.0:
                tangents = rows.by_parameters[kept][:, mine]
        return {"columns": np.column_stack([*columns, tangents])}

    def restored(self, item: Attachment, found: Plain) -> Array:
        columns: Array = found["columns"]
        return columns

    def name(self, item: Attachment) -> str:
        return item.label


def _split(
    rows: LinearRows, assembly: Assembly, base: Problem, label: str
) -> tuple[NDArray[np.intp], list[int]]:
    """Rows that the model without the effect has, too (not those of the effect's data sheet), and
    columns of the effect's own parameters."""
    free = rows.by_parameters.shape[1]
    tracks = base.tracks
    keys = [assembly.parameters[i].key for i in free_parameters(assembly, tracks)]
    mine = [i for i, key in enumerate(keys) if key.startswith(f"{label}:")]
    first = len(rows.away) - free
    kept = [*range(first), *(first + i for i in range(free) if i not in mine)]
    return np.array(kept), mine


def _amounts(own: Sequence[Bound]) -> list[Bound]:
    return [b for b in own if b.null is not None]


def _amount(evidence: DataSplit, a: Attachment, sizes: Sizes) -> Amount | None:
    """The first of an effect's parameters at whose null it vanishes."""
    assembly = model_with(evidence, (a,), sizes)
    first = next(
        (b for b in assembly.parameters if b.owner == a.label and b.null is not None), None
    )
    return Amount(first.name, first.unit, first.value / first.factor) if first else None


@dataclass(frozen=True, eq=False)
class _Projected:
    """Rows that count, and an orthonormal base of what parameters and starts can change in them."""

    counted: NDArray[np.bool_]
    spanned: Array

    @classmethod
    def of(cls, ground: LinearRows, counted: NDArray[np.bool_]) -> _Projected:
        columns = np.column_stack([ground.by_parameters, ground.by_starts])[counted]
        scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        u, s, _ = np.linalg.svd(columns / scale, full_matrices=False)
        return cls(counted, u[:, s > 1e-9 * s[0]] if len(s) else u)

    def __call__(self, columns: Array) -> Array:
        own = columns[self.counted]
        return np.asarray(own - self.spanned @ (self.spanned.T @ own))


def _channel_of_rows(base: Fit, ground: LinearRows, settings: PowerSettings) -> NDArray[np.intp]:
    """Channel of every row; -1 for joints between windows and the data sheet."""
    problem, channels = base.problem, base.problem.tracks[0].y.shape[1]
    every = max(1, -(-sum(t.y.size for t in problem.tracks) // settings.rows))
    found = list[NDArray[np.intp]]()
    for track, starts in zip(problem.tracks, base.starts, strict=True):
        windows = problem.windows(track)
        for w, window in enumerate(windows):
            samples = -(-(window.stop - window.start) // every)
            found.append(np.tile(np.arange(channels), samples))
            if w + 1 < len(windows):
                found.append(np.full(starts.shape[1], -1))
    found.append(np.full(ground.by_parameters.shape[1], -1))
    return np.concatenate(found)


def _inner(
    projected: _Projected, responses: dict[str, Array], usual: int, count: int
) -> dict[str, tuple[Array, Array]]:
    """Of every effect that stays finite: its response at the usual size, projected, and an
    orthonormal base of it with the derivatives by its own parameters."""
    found = {}
    for label, columns in responses.items():
        if not np.isfinite(columns).all():
            continue
        own = projected(np.column_stack([columns[:, usual], columns[:, count:]]))
        scale = np.maximum(np.linalg.norm(own, axis=0), 1e-300)
        u, s, _ = np.linalg.svd(own / scale, full_matrices=False)
        found[label] = own[:, 0], u[:, s > 1e-6 * s[0]]
    return found


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
