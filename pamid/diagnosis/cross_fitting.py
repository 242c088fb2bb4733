"""The two halves of what is held out, the other way round.

One half chooses the effect and the other reports how far the gap shrinks; swapped, the half that
reported chooses among the same fitted models, and the first half reports. Every held-out window so
reports of a model that it had no part in choosing, and none is lost to the choice: a transient that
fell into one half is weighed in either part. Where the two halves choose other families, the choice
hangs on which windows were asked, and that is said.

Stone (1974), Cross-validatory choice and assessment of statistical predictions, J. R. Stat. Soc. B
36(2), 111-147; Chernozhukov et al. (2018), Double/debiased machine learning, Econometrics J. 21(1)
(cross-fitting).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pamid.diagnosis.candidate_model import CandidateModel
from pamid.diagnosis.search import Search, indistinguishable_from_first, ranked

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Crossed:
    """best: the model that one half chose; other: what the other half chooses among those fitted;
    steady: is a family of either among those that the other half cannot tell from its own?"""

    best: CandidateModel
    other: CandidateModel
    steady: bool


def crossed(
    search: Search,
    ranking: tuple[CandidateModel, ...],
    best: CandidateModel,
    tied: tuple[CandidateModel, ...],
    classes: list[list[str]],
) -> Crossed | None:
    """The choice of the windows that have not chosen `best`; None where there are none, or nothing
    to choose from."""
    if not best.attached or search.chosen.all() or not search.chosen.any():
        return None
    swapped = replace(search, chosen=~search.chosen)
    order = ranked(swapped, list(ranking))
    other = order[0]
    if len(best.attached) > 1:
        alone, together = swapped.losses([other, best]).mean(axis=1)
        other = best if together < alone else other
    named = {search.family(a) for a in best.attached}
    also = {c.family for c in indistinguishable_from_first(swapped, order, classes)}
    steady = other is best or other.family in named | {c.family for c in tied} or bool(named & also)
    return Crossed(best, other, steady)


def reported(
    found: Crossed | None, chosen: NDArray[np.bool_], c: CandidateModel
) -> tuple[Array, NDArray[np.bool_]]:
    """Errors of a model per held-out window and channel, and the windows that report them: all of
    them, those that chose this model by what the other half chose."""
    if found is None:
        return c.absolutes, chosen if chosen.all() else ~chosen
    everywhere = np.ones_like(chosen)
    if c is not found.best:
        return c.absolutes, everywhere
    return np.where(chosen[:, None], found.other.absolutes, c.absolutes), everywhere
