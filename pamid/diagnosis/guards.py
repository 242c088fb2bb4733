"""Physical reasons for which a model is set aside, however well it predicts.

A parameter ended at a bound that physics did not set. An amount ended at nothing, so that the model
is a plainer model. A parameter ended where the effect belongs to another family (hysteresis that
slips at once is dry friction). The effect switches the input off. The effect duplicates a term of
the rig.

Where a rig has a term for the drag of its guide, viscous friction there duplicates that term. So
does a damping that depends on the direction and ended the same in both. Such an effect removes
nothing that refitted parameters could not. If the model with it is better all the same, the term
changes something else: a rough map, stated as a share of the value at the port, then applies to
less.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import FileError
from pamid.diagnosis.candidate_model import CandidateModel
from pamid.diagnosis.input_response import explained_channels
from pamid.diagnosis.ranges import at_bounds, at_limits, vanished
from pamid.diagnosis.search import Search
from pamid.diagnosis.settings import Settings
from pamid.engine.symbolic.expression import substitute, symbol, symbols
from pamid.engine.symbolic.vocabulary import Expr, Number, expression
from pamid.estimation.intervals import estimates
from pamid.model.attachment import Attachment
from pamid.model.effect import Effect
from pamid.model.rig import Rig
from pamid.model.trace import Passage, trace


@dataclass(frozen=True, eq=False)
class Guards:
    """Objections to the models of a search."""

    search: Search
    _objections: dict[CandidateModel, tuple[str, ...]] = field(default_factory=dict)

    def objections(self, model: CandidateModel) -> tuple[str, ...]:
        """Reasons against naming a model; empty without any."""
        if model in self._objections:
            return self._objections[model]
        reasons = []
        settings, base = self.search.settings, self.search.budget.baseline
        acting: list[Attachment] = []
        for added in model.additions:
            # a member whose amount ended at nothing is no part of the model that is named
            acting += [a for a in added.members if not vanished(model, a.label)] or added.members
        for a in acting:
            if ended := at_bounds(model, settings, a.label):
                reasons.append(f"{', '.join(ended)} of {a.label} ended at a bound")
            if gone := vanished(model, a.label):
                reasons.append(f"{', '.join(gone)} of {a.label} ended at zero effect")
            for name, family in at_limits(model, a).items():
                # without a candidate of that family it is the best name there is
                if any(
                    self.search.family(k) == family and set(k.ports) & set(a.ports)
                    for k in self.search.candidates
                ):
                    reasons.append(
                        f"{name} of {a.label} ended at a value where the effect is {family}"
                    )
            if terms := duplicated_terms(model, a.label, base, settings):
                reasons.append(f"{a.label} duplicates {', '.join(terms)} of the rig")
        self._objections[model] = tuple(reasons)
        return self._objections[model]

    def ignores_inputs(self, model: CandidateModel) -> bool:
        """Whether a model explains no channel by its inputs, to which the outputs respond."""
        search, reason = self.search, "it predicts no better with the recorded inputs than without"
        if reason in self.objections(model):
            return True
        # Free runs cost far more than the objections above, so that this test runs only for models
        # that would be named.
        ignores = not explained_channels(search.budget, model, search.response, search.seed).any()
        if ignores:
            self._objections[model] = (*self.objections(model), reason)
        return ignores


# ---- terms of the rig ----------------------------------------------------------------------------


def duplicated_terms(
    model: CandidateModel, label: str, base: CandidateModel, settings: Settings
) -> tuple[str, ...]:
    """The rig's fitted parameters whose terms at the same port duplicate an effect of the
    model; empty where none do.

    Let e(t) be the contribution of the effect to the value at the port, and d_j(t) the derivative
    of that value by parameter j at fixed states, along the fitted windows. The terms duplicate the
    effect where their best combination leaves at most `settings.own_terms` of e.

    A parameter that also acts elsewhere does not count: the flow of a pipe out of a tank enters
    the next, a leak does not. Nor does a parameter that would have to leave its data sheet: a ruler
    does not err by a third. base: the model without effects; a parameter at a bound there was not
    free to move, and does not count either.
    """
    (attached,) = (a for a in model.attached if a.label == label)
    passed = [q for q in model.assembly.traced.passages if q.port in attached.ports]
    places = _parameters_at_port(model, passed, base)
    bounds = model.assembly.parameters
    null = {
        symbol("parameter", b.key): expression(b.null)
        for b in bounds
        if b.owner == label and b.null is not None
    }
    if not places or not null:
        return ()
    # memories of the effect vanish with it
    null |= {
        symbol(space, name): expression(0.0)
        for space, name in symbols([q.result for q in passed])
        if space == "state" and name.startswith(f"{label}.")
    }
    added, terms = _along_fit(model, passed, null, places)
    size = np.sqrt((terms**2).mean(axis=0))
    places = [i for i, s in zip(places, size, strict=True) if s > 0.0]
    terms, size = terms[:, size > 0.0], size[size > 0.0]
    all_of_it = float(np.sqrt((added**2).mean()))
    # An effect that adds nothing duplicates every term; `vanished` reports it.
    if not places or not np.isfinite(all_of_it + size.sum()) or all_of_it == 0.0:
        return ()
    # Terms differ by orders of magnitude in SI units. Unit columns keep the cutoff of small
    # singular values from dropping a term that only has a small unit.
    weight = np.linalg.lstsq(terms / size, added, rcond=None)[0]
    left = float(np.sqrt(((added - terms / size @ weight) ** 2).mean()))
    least = settings.own_terms * all_of_it
    if left > least:
        return ()
    scale, free, p = model.fit.problem.scale, list(model.fit.problem.free), model.fit.p.copy()
    before = scale.inside(p[free])
    p[places] += weight / size
    # A parameter that is far off already would be blamed for its distance, not for the effect's.
    most = np.maximum(settings.far_off, np.abs(before))
    if (np.abs(scale.inside(p[free])) > most).any():
        return ()
    return tuple(bounds[i].name for i, w in zip(places, weight, strict=True) if abs(w) > least)


def _parameters_at_port(
    model: CandidateModel, passed: list[Passage], base: CandidateModel
) -> list[int]:
    """Places of the rig's fitted parameters that act at the port of these passages alone, and ended
    at no bound without the effect."""
    # An effect at two ports moves something between them. No term of a single port does
    # that.
    if len({q.port for q in passed}) != 1:
        return []
    bounds = model.assembly.parameters
    entering = {name for space, name in symbols([q.value for q in passed]) if space == "parameter"}
    places = [
        i for i in model.fit.problem.free if not bounds[i].owner and bounds[i].key in entering
    ]
    if not places:
        return []
    # Without the effect such a parameter wanted to go further and was not allowed to. The effect
    # does then what the term could not.
    ended = {b.key for b, e in estimates(base.fit).items() if e.at_bound}
    other = ended | _acting_elsewhere(base.assembly.rig)[passed[0].port]
    return [i for i in places if bounds[i].key not in other]


def _along_fit(
    model: CandidateModel, passed: list[Passage], null: dict[Expr, Expr], places: list[int]
) -> tuple[Array, Array]:
    """Contribution of the effect to these passages along the fit, and the derivatives of the values
    that enter them by these parameters (samples; samples x parameters)."""
    bounds, p = model.assembly.parameters, model.fit.p
    # relative: by which a parameter is moved to see its term
    # Longer than the usual square root: a term that is linear in its parameter has no truncation
    # error, and rounding of a large value would hide a small term.
    least = float(np.finfo(float).eps) ** 0.25
    steps = [least * max(abs(float(p[i])), least * abs(bounds[i].high)) for i in places]
    moves = [
        {at: at + step}
        for at, step in zip(
            (symbol("parameter", bounds[i].key) for i in places), steps, strict=True
        )
    ]
    wanted: list[Expr] = []
    for q in passed:
        (without,) = substitute([q.result], null)
        wanted.append(q.result - without)
        for move, step in zip(moves, steps, strict=True):
            (moved,) = substitute([q.value], move)
            wanted.append((moved - q.value) * (1.0 / step))
    rows = model.along_fit(wanted).reshape(-1, 1 + len(places))
    return rows[:, 0], rows[:, 1:]


class _Closed(Effect):
    """Nothing comes out of the port."""

    name = "closed"

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        return 0.0


@lru_cache(maxsize=64)  # computed for every effect that leads
def _acting_elsewhere(rig: Rig) -> dict[str, frozenset[str]]:
    """By port: parameters that the rig's equations read besides its value. The port is closed for
    this, and its value stays: a reading of a sensor may act in the machine as well."""
    parameters = {}
    for closed in rig.ports:

        def effects_at(port: str, _: str, closed: str = closed) -> list[tuple[str, Effect]]:
            return [("", _Closed())] if port == closed else []

        try:
            rest = trace(rig, effects_at, {})
        except FileError:  # not defined there: the port stays open
            rest = trace(rig, lambda *_: [], {})
        read = symbols([*rest.rates.values(), *rest.outputs.values()])
        parameters[closed] = frozenset(name for space, name in read if space == "parameter")
    return parameters
