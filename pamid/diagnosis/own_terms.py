"""Does an effect do what a parameter of the rig does already?

Where a rig has a term for the drag of its guide, viscous friction there is that term once more, and
so is a damping that depends on the direction and came out the same in both. Such an effect takes
nothing up that refitted parameters could not; where the model with it is better all the same, it is
so by what else changes with the term: a rough map, stated as a share of what passes the port, then
applies to less.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pamid.base.errors import FileError
from pamid.diagnosis.candidate_model import CandidateModel
from pamid.diagnosis.settings import DEFAULT, Settings
from pamid.estimation.intervals import estimates
from pamid.model.effect import Effect
from pamid.model.rig import Rig
from pamid.model.trace import trace
from pamid.symbolic.expression import substitute, symbol, symbols
from pamid.symbolic.vocabulary import Expr, Number, expression

Array = NDArray[np.float64]


def own_terms(
    model: CandidateModel, label: str, base: CandidateModel, settings: Settings = DEFAULT
) -> tuple[str, ...]:
    """The rig's own fitted parameters, by their names outside, whose terms at the same port do what
    one of the model's effects does there; empty where they do not.

    With e(t) what the effect adds to the value that passes, d_j(t) the derivative of that value by
    parameter j with the states as they are, along the fitted windows: what the best combination of
    the d_j leaves of e is no more than `settings.own_terms` of it. A parameter that acts elsewhere,
    too, does something else: what a pipe takes out of one tank comes into the next, what a leak
    takes does not. base: the model without effects; a parameter that ended at a bound there could
    do no more, and does not count.
    """
    (attached,) = (a for a in model.attached if a.label == label)
    passed = [q for q in model.assembly.traced.passages if q.port in attached.ports]
    if len({q.port for q in passed}) != 1:
        return ()
    bounds, p = model.assembly.parameters, model.fit.p
    entering = {name for space, name in symbols([q.value for q in passed]) if space == "parameter"}
    own = [i for i in model.fit.problem.free if not bounds[i].owner and bounds[i].key in entering]
    if not own:
        return ()
    ended = {e.bound.key for e in estimates(base.fit) if e.at_bound}
    other = ended | _acting_elsewhere(base.assembly.rig)[passed[0].port]
    own = [i for i in own if bounds[i].key not in other]
    null = {
        symbol("parameter", b.key): expression(b.null)
        for b in bounds
        if b.owner == label and b.null is not None
    }
    if not own or not null:
        return ()
    # what the effect remembers is the effect's, too: gone with it
    remembered = {
        symbol(space, name): expression(0.0)
        for space, name in symbols([q.result for q in passed])
        if space == "state" and name.startswith(f"{label}.")
    }
    # relative: by which a parameter is moved to see its term
    least = float(np.finfo(float).eps) ** 0.25
    steps = [least * max(abs(float(p[i])), least * abs(bounds[i].high)) for i in own]
    wanted: list[Expr] = []
    for q in passed:
        without = substitute([q.result], null | remembered)[0]
        moved = [
            substitute([q.value], {at: at + step})[0]
            for at, step in zip(
                (symbol("parameter", bounds[i].key) for i in own), steps, strict=True
            )
        ]
        wanted += [
            q.result - without,
            *((one - q.value) * (1.0 / s) for one, s in zip(moved, steps, strict=True)),
        ]
    rows = model.along_fit(wanted).reshape(-1, 1 + len(own))
    added, terms = rows[:, 0], rows[:, 1:]
    size = np.sqrt((terms**2).mean(axis=0))
    terms = terms[:, size > 0.0] / size[size > 0.0]
    all_of_it = float(np.sqrt((added**2).mean()))
    if not terms.size or not np.isfinite(rows).all() or all_of_it == 0.0:
        return ()
    weight = np.linalg.lstsq(terms, added, rcond=None)[0]
    left = float(np.sqrt(((added - terms @ weight) ** 2).mean()))
    if left > settings.own_terms * all_of_it:
        return ()
    names = [bounds[i].name for i, s in zip(own, size, strict=True) if s > 0.0]
    return tuple(
        n for n, w in zip(names, weight, strict=True) if abs(w) > settings.own_terms * all_of_it
    )


class _Closed(Effect):
    """Nothing comes out of the port."""

    name = "closed"

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        return 0.0


@lru_cache(maxsize=64)  # asked of every effect that leads
def _acting_elsewhere(rig: Rig) -> dict[str, frozenset[str]]:
    """By port: parameters that the rig's equations read beside what passes it. The port is closed
    for this, not its value left out: what a sensor reads may act in the machine as well."""
    found = {}
    for closed in rig.ports:

        def effects_at(port: str, _: str, closed: str = closed) -> list[tuple[str, Effect]]:
            return [("", _Closed())] if port == closed else []

        try:
            rest = trace(rig, effects_at, {})
        except FileError:  # not defined there: nothing can be said of the port
            rest = trace(rig, lambda *_: [], {})
        read = symbols([*rest.rates.values(), *rest.outputs.values()])
        found[closed] = frozenset(name for space, name in read if space == "parameter")
    return found
