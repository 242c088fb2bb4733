"""Family of an effect outside the catalogue: the family whose free form absorbs the remainder.

Free forms (`pamid.model.free_form`) have no law, only the common property of a family, so that they
take no part in the ranking of causes. Where a material part of the gap remains, free forms that fit
the ports with latent evidence are fitted on top of the model, all parameters jointly. They are
compared with the model on the same held-out windows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import cast

import numpy as np

from pamid.base.parallel.jobs import Failed
from pamid.base.schemas.diagnosis_file import FormCurve, GapShare
from pamid.base.units import display_unit, from_si, size_from_si, unit_label
from pamid.diagnosis.candidate_model import CandidateModel, transferred
from pamid.diagnosis.comparison import Comparison
from pamid.diagnosis.search import RefitStart, RefitWork, Search
from pamid.engine.symbolic.vocabulary import Expr
from pamid.estimation.grey_box import model_with
from pamid.estimation.intervals import NORMAL_95
from pamid.model.attachment import Attachment, attachments
from pamid.model.determined_signals import determined
from pamid.model.free_form import FreeFormEffect
from pamid.model.registry import free_form_effects
from pamid.model.rig import Port, Rig

FORM_TAIL = 0.5  # per cent of the samples beyond either end of a curve: outliers

Span = tuple[float, float]  # lowest and highest value (SI)
Reached = dict[tuple[str, str], Span]  # by port and signal


@dataclass(frozen=True, eq=False)
class FreeForm:
    """A free form that absorbs a material share of a model's remainder. removes: share of the
    gap."""

    model: CandidateModel = field(repr=False)
    removes: GapShare
    curve: FormCurve

    @property
    def attachment(self) -> Attachment:
        return self.model.attached[-1]

    @property
    def family(self) -> str:
        return self.model.family

    @property
    def port(self) -> str:
        """The port (group) under which it is reported."""
        return self.model.group

    @property
    def known_by(self) -> str:
        """Common property of the family, in words."""
        return _form(self.attachment).known_by


def free_forms(
    search: Search, comparison: Comparison, best: CandidateModel, ports: Sequence[str]
) -> list[FreeForm]:
    """Free forms at these ports that remove a material share of the remainder of `best`.

    The best and those that tie with it, the best first. best: with effects or without.
    """
    rig, reached = search.evidence.rig, reached_at(best, ports)
    forms = attachments(rig, free_form_effects().values())
    determined_forms, _ = determined(
        rig, search.evidence.channels, search.evidence.still_inputs, forms
    )
    starts = [
        _start(search, best, a, span)
        for a in determined_forms
        # A curve is drawn over the signal of a single port.
        if len(a.ports) == 1 and a.ports[0] in ports
        if (span := _span(a, rig, reached)) is not None
    ]
    work = RefitWork(search.evidence, best.fit, search.budget.sizes)
    models = [
        c
        for c in search.pool.run(work, starts, search.progress)
        if not isinstance(c, Failed) and c.finite and comparison.is_material(c, best)
    ]
    ordered = comparison.ordered(models)
    return [
        FreeForm(c, comparison.removed(c, best), curve_of(c))
        for c in ordered
        if c is ordered[0] or comparison.is_tied(c, ordered[0])
    ]


def _form(a: Attachment) -> FreeFormEffect:
    return cast(FreeFormEffect, a.effect)


def _start(search: Search, best: CandidateModel, a: Attachment, span: Span) -> RefitStart:
    """At the model without the form, whose shapes are placed where the recordings went."""
    attached = (*best.attached, a)
    assembly = model_with(search.evidence, attached, search.budget.sizes)
    # The form is to take up what the model leaves, so that the fit starts at this model and not at
    # the data sheet.
    p = transferred(assembly, (best.assembly, best.fit.p))
    for name, value in _form(a).placed(*span).items():
        p[assembly.keys[f"{a.label}:{name}"]] = value
    return RefitStart(attached, p, assembly=assembly)


def _along(a: Attachment, port: Port) -> str:
    """The name under which the port offers the signal that the form's curve is drawn over."""
    return a.effect.offered_as(_form(a).along, port.signals)


def _span(a: Attachment, rig: Rig, reached: Reached) -> Span | None:
    """Range of its curve; None where its signal is not offered, or rests."""
    name = a.ports[0]
    if _form(a).along == "time":
        return reached.get((name, "value"))
    return reached.get((name, _along(a, rig.ports[name])))


def curve_of(c: CandidateModel) -> FormCurve:
    """Curve of a model's last effect, a free form, over the range of the recordings, with the 95 %
    band of the fit's covariance, in display units."""
    a, fit = c.attached[-1], c.fit
    port, form = c.assembly.rig.ports[a.ports[0]], _form(a)
    along = _along(a, port)
    span = _span(a, c.assembly.rig, reached_at(c, a.ports))
    bounds = c.assembly.parameters
    places = {b.key.rpartition(":")[2]: i for i, b in enumerate(bounds) if b.owner == a.label}
    p = SimpleNamespace(**{name: float(fit.p[i]) for name, i in places.items()})
    shapes = form.curve(p, *(span or (0.0, 0.0)))
    coefficients = np.array([fit.p[places[name]] for name in form.coefficients()])
    y = shapes.base + shapes.columns @ coefficients
    free = list(fit.problem.free)
    rows = [free.index(places[name]) for name in form.coefficients()]
    # A fit works in prior spreads, on a logarithm for factors. The chain rule converts its
    # covariance to SI units.
    slope = fit.problem.scale.slope(fit.p[free])[rows]
    known = fit.covariance[np.ix_(rows, rows)] * np.outer(slope, slope)
    # The curve is linear in its coefficients, so that their covariance gives its variance exactly.
    variance = np.einsum("ij,jk,ik->i", shapes.columns, known, shapes.columns)
    half = NORMAL_95 * np.sqrt(np.maximum(variance, 0.0))
    shared = form.along == "time"  # a response is a share of the step
    x_unit = unit_label(display_unit("s" if shared else port.unit_of(along)))
    y_unit = "" if shared else unit_label(display_unit(port.unit))
    lower, middle, upper = (size_from_si(v, y_unit) for v in (y - half, y, y + half))
    return FormCurve(
        signal=along,
        signal_unit=x_unit,
        shown=form.shown,
        unit=y_unit,
        x=tuple(map(float, from_si(shapes.x, x_unit))),
        y=tuple(map(float, middle)),
        low=tuple(map(float, lower)),
        high=tuple(map(float, upper)),
    )


def reached_at(c: CandidateModel, ports: Sequence[str]) -> Reached:
    """Ranges (SI) of values and signals at these ports over the windows of the fit, without
    outliers. Several places of a port are taken together."""
    wanted: dict[tuple[str, str, str], Expr] = {
        (q.port, q.where, name): value
        for q in c.assembly.traced.passages
        if q.port in ports
        for name, value in (("value", q.value), *q.signals)
        if isinstance(value, Expr)
    }
    # A single overshoot would stretch the curve over a range without data, where its coefficients
    # are free.
    inside = [FORM_TAIL, 100.0 - FORM_TAIL]
    ends = np.percentile(c.along_fit(list(wanted.values())), inside, 0)
    reached: Reached = {}
    for (port, _, name), low, high in zip(wanted, *ends, strict=True):
        before = reached.get((port, name), (np.inf, -np.inf))
        reached[port, name] = (min(before[0], float(low)), max(before[1], float(high)))
    return {key: (low, high) for key, (low, high) in reached.items() if high > low}
