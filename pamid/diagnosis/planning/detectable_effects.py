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

its visibility, which has to exceed the margin that a diagnosis calls no gap. Next to another effect
f, which may take any size and the derivatives T_f of its parameters,

    z_(e|f) = min over a, b of |P (D_e - a D_f - T_f b)|

and f is confused with e where little of z_e is left. Silvey (1980), Optimal Design, for information
about some parameters in addition to others; Atkinson and Fedorov (1975), Biometrika 62:57, for that
about models.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.base.parallel.jobs import Failed, Work, WorkerPool
from pamid.base.progress import Progress, silent
from pamid.base.schemas.command_files import ShownEffect, UsualAmount
from pamid.diagnosis.candidate_model import transferred
from pamid.diagnosis.settings import DEFAULT
from pamid.estimation.grey_box import model_with
from pamid.estimation.linear_rows import LinearRows, linear_rows, orthonormal_span
from pamid.estimation.observed_sizes import observed_sizes
from pamid.estimation.problem import Fit, Problem, free_parameters
from pamid.estimation.robust_fit import fit_robustly
from pamid.model.attachment import Attachment, attachments
from pamid.model.bound_parameter import Sizes
from pamid.model.effect import Effect
from pamid.simulation.data_split import DataSplit

# multiples of an effect's usual size at which the experiment is tried
SIZES = (0.1, 0.3, 1.0, 3.0)
USUAL = SIZES.index(1.0)
# visibility from which an effect shows: a diagnosis calls a smaller error no gap
SEEN = 1.0 + DEFAULT.floor_margin
# standard errors below which an effect is not reported, nor two separated
SURE = 3.0
ROWS = 6000  # residuals at most, thinned evenly
FINER = 3  # times that the steps are halved where an effect is too stiff


def experiment_power(
    evidence: DataSplit,
    catalogue: dict[str, type[Effect]],
    *,
    pool: WorkerPool | None = None,
    progress: Progress = silent,
) -> tuple[ShownEffect, ...]:
    """Detectability of every effect in the fitted part of the data, recordings of a rig that has
    none of them: the plainest first. Whatever can act at a port of the rig is tried."""
    pool = pool or WorkerPool()
    progress("fitting the experiment without any effect")
    sizes = observed_sizes(evidence)
    assembly = model_with(evidence, (), sizes)
    tracks = evidence.tracks(assembly)
    base = fit_robustly(Problem(assembly, tracks, free_parameters(assembly, tracks)))
    ground = linearised(base, base.problem, base.p)
    work = _Responding(evidence, base, sizes, ground.away)
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
    channel_rows = {c: ground.channel == k for k, c in enumerate(channels)}
    only = {
        c: _Projected.of(ground, rows | (ground.channel < 0)) for c, rows in channel_rows.items()
    }
    samples = {c: float(sum(t.seen[k] * len(t) for t in tracks)) for k, c in enumerate(channels)}
    inner = _inner(everything, responses)
    effects = []
    for a, r in zip(candidates, powers, strict=True):
        amount, failed, tried, visible = None, "", list[Array](), list[float]()
        by_channel: dict[str, float] = {}
        confused: tuple[str, ...] = ()
        if isinstance(r, Failed):
            failed = r.why
        elif a.label not in inner:
            amount, failed = r.amount, "the rig with it becomes unstable"
        else:
            tried = [everything(r.columns[:, k]) for k in range(len(SIZES))]
            visible = [
                max(visibility(x[channel_rows[c]], samples[c]) for c in channels) for x in tried
            ]
            by_channel = {
                c: visibility(q(r.columns[:, USUAL])[channel_rows[c][q.counted]], samples[c])
                for c, q in only.items()
            }
            least = least_size(visible)
            amount = r.amount and r.amount.model_copy(
                update={"least": None if least is None else least * r.amount.usual}
            )
            confused = _confused(evidence, candidates, inner, a)
        effects.append(
            ShownEffect(
                effect=a.label,
                family=a.family(evidence.rig),
                port=a.group(evidence.rig),
                amount=amount,
                visible=tuple(visible),
                standard_errors=tuple(float(np.linalg.norm(x)) for x in tried),
                by_channel=by_channel,
                confused=confused,
                failed=failed,
            )
        )
    return tuple(
        sorted(effects, key=lambda e: (-(e.visible[USUAL] if e.visible else 0.0), e.effect))
    )


def least_size(visible: Sequence[float]) -> float | None:
    """The smallest multiple of the usual size that shows: by a power law between the sizes that
    were tried, in proportion below the smallest; None where the largest does not."""
    r = np.sqrt(np.maximum(np.square(visible) - 1.0, 1e-18))
    wanted = np.sqrt(SEEN**2 - 1.0)
    above = np.flatnonzero(r >= wanted)
    if not len(above):
        return None
    i = int(above[0])
    if i == 0:
        return float(SIZES[0] * wanted / r[0])
    near = slice(i - 1, i + 1)
    return float(np.exp(np.interp(np.log(wanted), np.log(r[near]), np.log(SIZES[near]))))


def visibility(changed: Array, samples: float) -> float:
    """Error of the refitted model over the noise floor: see the head of the module."""
    return float(np.sqrt(1.0 + changed @ changed / max(samples, 1.0)))


def linearised(base: Fit, problem: Problem, p: Array, *, derivatives: bool = True) -> LinearRows:
    """The rows of a model at p, next to a fit; with finer steps where an effect is too stiff for
    those of the rig."""
    at = replace(base, problem=problem, p=p)
    for _ in range(FINER):
        with np.errstate(over="ignore", invalid="ignore"):
            linear = linear_rows(at, ROWS, derivatives=derivatives)
        if linear.finite:
            break
        at = replace(at, stepping=at.stepping.doubled())
    return linear


@dataclass(frozen=True, eq=False)
class _Change:
    """Change of the rows by an effect, a column per size, then a column per parameter of the
    effect."""

    columns: Array
    amount: UsualAmount | None


@dataclass(frozen=True, eq=False)
class _Responding(Work[Attachment, _Change]):
    """ground: the rows of the fit."""

    what = "response to"
    evidence: DataSplit
    base: Fit
    sizes: Sizes
    ground: Array

    def __call__(self, item: Attachment) -> _Change:
        assembly = model_with(self.evidence, (item,), self.sizes)
        effect_parameters = [b for b in assembly.parameters if b.owner == item.label]
        # derivatives by the effect's parameters are enough for it, those by the rig's
        # are the ground's: of an arm, or of a simulation that is stepped, they cost most by far
        fitted = frozenset(b.key for b in effect_parameters if b.fitted)
        assembly = replace(assembly, sensitive=fitted)
        tracks = self.evidence.tracks(assembly)
        free = free_parameters(assembly, tracks)
        mine = tuple(i for i in free if assembly.parameters[i].key in fitted)
        problem = Problem(assembly, tracks, mine)
        columns, tangents = list[Array](), np.zeros((len(self.ground), len(mine)))
        for size in SIZES:
            p = transferred(assembly, (self.base.problem.assembly, self.base.p))
            for b in effect_parameters:
                if b.null is not None:
                    usual = b.null + size * (b.value - b.null)
                    p[assembly.keys[b.key]] = min(max(usual, b.low), b.high)
            rows = linearised(self.base, problem, p, derivatives=size == 1.0)
            # rows that the model without the effect has, too: not those of the effect's data
            # sheet, which are the last, but those of the rig's, which stays as it was fitted
            common = len(rows.away) - len(mine)
            columns.append(np.append(rows.away[:common], self.ground[common:]) - self.ground)
            if size == 1.0:
                tangents[:common] = rows.by_parameters[:common]
        amount = None
        # the first of its parameters at whose null the effect vanishes states how large it is
        if first := next((b for b in effect_parameters if b.null is not None), None):
            usual = first.value / first.factor
            amount = UsualAmount(parameter=first.name, unit=first.unit, usual=usual, least=None)
        return _Change(np.column_stack([*columns, tangents]), amount)


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
        counted = columns[self.counted]
        return np.asarray(counted - self.spanned @ (self.spanned.T @ counted))


def _inner(projected: _Projected, responses: dict[str, Array]) -> dict[str, tuple[Array, Array]]:
    """Of every effect that stays finite: its response at the usual size, projected, and an
    orthonormal base of it with the derivatives by its parameters."""
    spans = {}
    for label, columns in responses.items():
        with np.errstate(over="ignore", invalid="ignore"):  # slopes of what runs away may be large
            size = np.square(columns).sum()
        if not np.isfinite(size):
            continue
        inner = projected(np.column_stack([columns[:, USUAL], columns[:, len(SIZES) :]]))
        spans[label] = inner[:, 0], orthonormal_span(inner)
    return spans


def _confused(
    evidence: DataSplit,
    candidates: Sequence[Attachment],
    inner: dict[str, tuple[Array, Array]],
    a: Attachment,
) -> tuple[str, ...]:
    """Effects of other families that leave little of this effect, the least first."""
    response = inner[a.label][0]
    whole = float(np.linalg.norm(response))
    if whole < SURE:
        return ()
    left = {
        other.label: float(np.linalg.norm(response - base @ (base.T @ response)))
        for other in candidates
        if other.label in inner and other.family(evidence.rig) != a.family(evidence.rig)
        for base in [inner[other.label][1]]
    }
    least = max(SURE, DEFAULT.alike_share * whole)
    alike = [k for k, v in left.items() if v < least]
    return tuple(sorted(alike, key=lambda k: left[k]))
