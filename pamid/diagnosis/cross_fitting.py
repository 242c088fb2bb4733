"""What the two halves of what is held out would have chosen, and report of each other's choice.

The best model is chosen on everything held out. What it would do elsewhere is told by windows that
had no part in choosing: of the fitted models either half chooses one by the same rules, and the
other half reports its errors, so that every held-out window reports and none of its own choice.
Where a half chooses another family, the choice hangs on which windows were asked, and that is said.

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
    """best: the model that all windows chose; half: of the held-out windows; choices: what this
    half chooses among those fitted, and what the other half does; steady: are the families of both
    among those that all windows together cannot tell from their own choice?"""

    best: CandidateModel
    half: NDArray[np.bool_]
    choices: tuple[CandidateModel, CandidateModel]
    steady: bool


def crossed(
    search: Search,
    ranking: tuple[CandidateModel, ...],
    best: CandidateModel,
    tied: tuple[CandidateModel, ...],
    classes: list[list[str]],
) -> Crossed | None:
    """The choices of the halves; None where one has no windows, or there is nothing to choose
    from."""
    if not best.attached or search.half.all() or not search.half.any():
        return None
    own = {search.family(a) for a in best.attached}
    alike = own | {c.family for c in tied}
    choices, steady = list[CandidateModel](), True
    for rows in (search.half, ~search.half):
        half = replace(search, asked=rows)
        order = ranked(half, list(ranking))
        choice = order[0]
        if len(best.attached) > 1:
            alone, together = half.losses([choice, best]).mean(axis=1)
            choice = best if together < alone else choice
        also = {c.family for c in indistinguishable_from_first(half, order, classes)}
        steady &= choice is best or choice.family in alike or bool(own & also)
        choices.append(choice)
    return Crossed(best, search.half, (choices[0], choices[1]), steady)


def reported(found: Crossed | None, c: CandidateModel) -> Array:
    """Errors of a model per held-out window and channel; of the best one, those of the model that
    the other half of the windows has chosen."""
    if found is None or c is not found.best:
        return c.absolutes
    first, second = found.choices
    return np.where(found.half[:, None], second.absolutes, first.absolutes)
