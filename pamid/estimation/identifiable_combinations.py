"""Combinations of parameters that recordings determine where they do not determine the parameters
separately.

A rig may declare combinations by name (`Rig.combinations`), such as an inertia about a joint.
Further combinations follow from the fit's covariance C, in units of the data sheet's prior. The
deviation of a single parameter is sqrt(C_kk), and 1 / sqrt((C^-1)_kk) with the others given: a
parameter that is loose by the first and tight by the second is tied. The eigenvectors of a group's
C with small eigenvalues are determined by the recordings. In logarithms these are products of
powers, of which the simplest determined product is named. Practical identifiability: Raue et al.
(2009), Bioinformatics 25(15), 1923-1929; directions of the Hessian: Gutenkunst et al. (2007), PLoS
Comput. Biol. 3(10), e189.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations as subsets
from itertools import islice

import numpy as np

from pamid.base.arrays import Array
from pamid.base.schemas.estimates import Estimate
from pamid.base.schemas.fit_file import Combination, Tie
from pamid.estimation.intervals import NORMAL_95, SETTLED, estimates, word_for
from pamid.estimation.problem import Fit
from pamid.estimation.quantities import (
    NEW,
    Quantity,
    Space,
    Terms,
    declared_quantities,
    reported_values,
)
from pamid.model.bound_parameter import Bound

# by how much knowing the others must narrow a parameter to call it tied to them
GIVEN = 1.0 / 3.0
JOINED = 0.05  # share that two parameters must have in common in what is known, to be tied
PLAINER = 3.0  # how much looser a combination may be to be named for its plainness
MOST = 3000  # sets of parameters that are tried


_Candidate = tuple[float, int, Array, Terms]  # score, rank, derivatives, terms


def combinations_of(
    fitted: Fit, draws: Array | None = None
) -> tuple[dict[str, Combination], tuple[Tie, ...]]:
    """Declared combinations that hold a fitted parameter, and the groups of parameters determined
    only in combination."""
    space = Space(fitted.problem, reported_values(fitted), fitted.covariance)
    declared = declared_quantities(space, fitted.problem.assembly)
    combinations = {q.name: _combination(space, q, draws, True) for q in declared}
    ties = []
    for group in _groups(space):
        known = _known(space, group)
        named = _named(space, group, known, declared)
        for q in named:
            combinations.setdefault(q.name, _combination(space, q, draws, False))
        ties.append(
            Tie(
                parameters=tuple(space.names[k] for k in group),
                directions=known.shape[1],
                known=tuple(q.name for q in named),
            )
        )
    return combinations, tuple(ties)


def reported_parameters(fitted: Fit, draws: Array | None = None) -> dict[Bound, Estimate]:
    """`estimates`, with the declared combinations that hold inner parameters in the place of those
    (`Parameter.inner`).

    Their prior is linear in the inner parameters at the fit, because products of these may have no
    slope at the data sheet. Their strain is the largest of the inner parameters they hold.
    """
    reported = estimates(fitted, draws)
    inner = {b.full_name: (b, e) for b, e in reported.items() if b.inner}
    if not inner:
        return reported
    space = Space(fitted.problem, reported_values(fitted), fitted.covariance)
    for q in declared_quantities(space, fitted.problem.assembly):
        c = _combination(space, replace(q, slope_prior=q.slope), draws, True)
        members = [inner[name] for name in c.members if name in inner]
        if members:
            bound = replace(members[0][0], key=q.name, name=q.name, unit=q.unit, factor=1.0)
            reported[bound] = Estimate(
                value=c.value,
                low=c.low,
                high=c.high,
                prior=c.prior,
                unit=c.unit,
                word=c.word,
                strain=max(e.strain or 0.0 for _, e in members),
                at_bound=None,
                source="",
                null=None,
            )
    return {b: e for b, e in reported.items() if b.full_name not in inner}


def _groups(space: Space) -> Iterator[list[int]]:
    """Parameters that are not settled by themselves, but are once the others are given, and tied to
    each other. Inner parameters have no names that a reader would know."""
    loose = [
        k for k in space.named if space.covariance[k, k] > SETTLED**2 and not space.bounds[k].inner
    ]
    if not loose:
        return
    among = space.covariance[np.ix_(loose, loose)]
    # The diagonal of the inverse holds conditional variances, that of the covariance marginal
    # ones. A tie is a large ratio of the two.
    given = 1.0 / np.sqrt(np.linalg.inv(among).diagonal())
    enough = np.minimum(SETTLED, GIVEN * np.sqrt(among.diagonal()))
    tied = [k for k, deviation, most in zip(loose, given, enough, strict=True) if deviation < most]
    known = _known(space, tied)
    # `known known'` projects onto what is known: two parameters that have an entry there are in a
    # common combination. Squared again and again, the table of neighbours becomes that of the
    # groups.
    reach = np.abs(known @ known.T) > JOINED
    for _ in tied:
        reach = reach @ reach
    for row in dict.fromkeys(map(tuple, reach.tolist())):
        group = [k for k, here in zip(tied, row, strict=True) if here]
        if len(group) > 1 and _known(space, group).size:
            yield group


def _known(space: Space, group: list[int]) -> Array:
    """Orthonormal directions in the group's scaled parameters that are settled, (parameters,
    directions)."""
    values, vectors = np.linalg.eigh(space.covariance[np.ix_(group, group)])
    return np.asarray(vectors[:, values < SETTLED**2])


def _named(
    space: Space, group: list[int], known: Array, declared: list[Quantity]
) -> list[Quantity]:
    """Combinations that span what is known of a group: declared ones first, then quotients with
    those and the plainest of parameters, tightest first."""
    chosen: list[Quantity] = []
    basis = np.zeros((len(group), 0))

    def adds(slope: Array) -> bool:
        """Take the direction up if it does not follow from those before."""
        nonlocal basis
        direction = slope[group] / (np.linalg.norm(slope[group]) or 1.0)
        rest = direction - basis @ (basis.T @ direction)
        if basis.shape[1] == known.shape[1] or float(np.linalg.norm(rest)) < NEW:
            return False
        basis = np.linalg.qr(np.column_stack([basis, direction]))[0]
        return True

    near = [
        q
        for q in declared
        if float(np.linalg.norm(q.slope[group])) > 0.5 * float(np.linalg.norm(q.slope))
    ]
    for q in sorted(near, key=lambda q: space.share(q.slope, q.slope_prior)):
        if space.share(q.slope, q.slope_prior) < SETTLED and adds(q.slope):
            chosen.append(q)
    singles = [space.single(k) for k in group]
    candidates = [*_quotients(space, near, singles), *_plainest(space, group, known, singles)]
    for _, _, slope, terms in sorted(candidates, key=lambda f: f[:2]):
        if adds(slope):
            chosen.append(space.together(terms))
    return chosen


def _quotients(
    space: Space, declared: list[Quantity], singles: list[Quantity]
) -> Iterator[_Candidate]:
    """Settled quotients and products of a declared combination and another combination or a
    parameter."""
    declared, singles = [q for q in declared if q.log], [q for q in singles if q.log]
    for i, a in enumerate(declared):
        for rank, b in [(1, b) for b in declared[i + 1 :]] + [(2, b) for b in singles]:
            for n in (-1.0, 1.0):
                slope, share = space.share_together([(a, 1.0), (b, n)])
                if share < SETTLED:
                    yield rank * share, rank, slope, [(a, 1.0), (b, n)]


def _plainest(
    space: Space, group: list[int], known: Array, singles: list[Quantity]
) -> Iterator[_Candidate]:
    """Products of powers (or sums) of as few parameters as what is known allows, with plain powers
    where they serve."""
    # what the recordings leave open: the orthogonal complement, of u directions. Among u + 1
    # parameters there is always a combination that none of them moves, the null vector below.
    unknown = np.linalg.svd(known)[0][:, known.shape[1] :]
    for support in islice(subsets(range(len(group)), unknown.shape[1] + 1), MOST):
        direction = np.linalg.svd(unknown[list(support)].T)[2][-1]
        among = [
            (singles[i], w)
            for i, w in zip(support, direction.tolist(), strict=True)
            if abs(w) > 1e-6
        ]
        log = all(q.log for q, _ in among)
        # from a direction in prior spreads to the power of each parameter (or its factor in a sum)
        powers = [w / float((q.slope / q.value if log else q.slope).sum()) for q, w in among]
        first = max((abs(w), n) for (_, w), n in zip(among, powers, strict=True))[1]
        exact = [(q, float(f"{n / first:.3g}")) for (q, _), n in zip(among, powers, strict=True)]
        plain = [(q, n) for q, n in ((q, round(2.0 * n) / 2.0) for q, n in exact) if n]
        slope, share = space.share_together(exact)
        plain_slope, plain_share = space.share_together(plain)
        if plain_share < PLAINER * share:
            yield plain_share * PLAINER, len(plain) + 2, plain_slope, plain
        elif share < SETTLED:
            yield share * PLAINER**2, len(exact) + 2, slope, exact


def _combination(space: Space, q: Quantity, draws: Array | None, declared: bool) -> Combination:
    """The quantity with its interval: delta method (of the logarithm where it exists), or from
    draws."""
    reach = NORMAL_95 * space.spread(q.slope)
    low, high = q.value - reach, q.value + reach
    if q.log:
        low, high = (q.value * float(np.exp(side * reach / q.value)) for side in (-1.0, 1.0))
    share = space.share(q.slope, q.slope_prior)
    if draws is not None:
        drawn = np.array([q.of(space.at(s)) for s in draws])
        # Each draw is mapped before the percentiles are taken: a nonlinear combination has no
        # symmetric interval.
        low, high = (float(x) for x in np.percentile(drawn, [2.5, 97.5]))
        share = float(drawn.std() / np.linalg.norm(q.slope_prior))
    members = tuple(space.names[k] for k in np.flatnonzero(q.slope))
    return Combination(
        value=q.value,
        low=low,
        high=high,
        prior=q.prior,
        unit=q.unit,
        word=word_for(share),
        members=members,
        declared=declared,
    )
