"""The posterior of a fit, written to its fit.json, and read by a later fit of the same rig as its
prior.

The cost is -2 log posterior, so near its minimum the scaled parameters are normal with covariance C
= H^-1, H its reduced half Hessian (Laplace's approximation: Gelman et al. (2013), Bayesian Data
Analysis, 3rd ed., ch. 4.1). The data sheet's prior is N(0, I) in these units. The recordings alone
therefore hold the information C^-1 - I, which a later fit adds to that of its data sheet.

All free parameters are carried with their full covariance: after a gravity test only combinations
are known. Numbers stand in prior spreads around each parameter's centre (logarithms where the prior
is); centre and spread are stored with them, because those of an effect follow the recordings.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import ConvergenceError, DataError, FileError
from pamid.base.files import sha256_of
from pamid.base.result_file import need_result
from pamid.base.run_folder import FIT_FILE, Run
from pamid.base.schemas import fit_file as result
from pamid.estimation.prior import Prior
from pamid.estimation.problem import Fit, Problem
from pamid.estimation.quantities import reported_values, straight_coordinates
from pamid.simulation.data_split import DataSplit

FIT_ANEW = "Repeat the fit with `pamid fit`."
CLOCK_TERMS = ":drift"  # background terms counted from a recording's beginning


@dataclass(frozen=True, eq=False)
class EarlierPosterior:
    """Posterior of an earlier fit, from the fit.json at path.

    stated: value, and gradient at bounds, of the k parameters in spreads around their centres, by
    key, and the rig's other parameters as they were in it (SI); covariance (k, k): whole.

    fitted: sha256 of all recordings it rests on; ridges: groups of parameters known only in
    combination, none of which the rig declares.
    """

    path: Path
    sha256: str
    rig: str
    stated: result.Posterior
    covariance: Array
    fitted: frozenset[str]
    ridges: tuple[tuple[str, ...], ...]

    def prior(self, problem: Problem) -> Prior:
        """The posterior as a prior of this problem. Parameters that the earlier fit lacked have
        their data sheet alone."""
        scale, places = problem.scale, self._places(problem)
        places_now, there = [k for k, _ in places], [i for _, i in places]
        stated = self.stated
        centre, spread, value = (
            np.array(x, np.float64)[there] for x in (stated.centre, stated.spread, stated.value)
        )
        stretch = spread / scale.spread[places_now]
        size = len(problem.free)
        at, gradient, information = np.zeros(size), np.zeros(size), np.zeros((size, size))
        precision = np.linalg.inv(self.covariance[np.ix_(there, there)])
        # At the earlier optimum the half gradients of data sheet and recordings add up to `held`,
        # which is zero but for parameters at a bound: the recordings' part is held - value, as
        # their information is C^-1 - I. Parameters that are not carried over are marginalised: C
        # loses their rows, and the gradient becomes C_carried^-1 (C held)_carried.
        slope = precision @ (self.covariance @ np.array(stated.held, np.float64))[there]
        moved = (centre - scale.centre[places_now]) / scale.spread[places_now]
        at[places_now] = moved + value * stretch
        gradient[places_now] = (slope - value) / stretch
        information[np.ix_(places_now, places_now)] = (
            precision - np.eye(len(places_now))
        ) / np.outer(stretch, stretch)
        covariance: Array = np.linalg.inv(np.eye(size) + information).astype(np.float64, copy=False)
        return Prior.about(
            at,
            information,
            gradient,
            straight_coordinates(problem, self._values(problem, at), covariance),
        )

    def _values(self, problem: Problem, at: Array) -> Array:
        """All parameters (SI) of the problem as they were in the earlier fit."""
        p, keys = problem.assembly.values(), problem.assembly.keys
        for key, value in self.stated.others.items():
            if key in keys:
                p[keys[key]] = value
        p[list(problem.free)] = problem.scale.outside(at)
        return p

    def _places(self, problem: Problem) -> list[tuple[int, int]]:
        """(place among the problem's free parameters, place here) of everything that is carried
        over."""
        keys = [problem.assembly.parameters[i].key for i in problem.free]
        where = {key: i for i, key in enumerate(self.stated.keys) if not key.endswith(CLOCK_TERMS)}
        places = [(k, where[key]) for k, key in enumerate(keys) if key in where]
        for k, i in places:
            if self.stated.log[i] != bool(problem.scale.log[k]):
                raise FileError(
                    f"{self.path}: the prior of {keys[k]!r} is logarithmic in only one of "
                    "that fit and the rig.",
                    FIT_ANEW,
                )
        return places

    def remarks(self, problem: Problem) -> list[str]:
        """Remarks on the step from that fit to this fit, a sentence each."""
        bounds, keys = problem.assembly.parameters, self.stated.keys
        carried = {keys[i] for _, i in self._places(problem)}
        notes = [
            f"{key} was held at its {'low' if slope > 0.0 else 'high'} bound in "
            f"{self.path.parent}; beyond the bound its prior is extrapolated."
            for key, slope in zip(keys, self.stated.held, strict=True)
            if slope
        ]
        notes += [
            f"{', '.join(group)} were known only in combination, but the rig declares no such "
            "combination: intervals may be too narrow."
            for group in self.ridges
        ]
        lost = [key for key in keys if key not in carried and not key.endswith(CLOCK_TERMS)]
        notes += (
            [f"Priors not used, because this fit holds the parameters fixed: {', '.join(lost)}."]
            if lost
            else []
        )
        if any(key.endswith(CLOCK_TERMS) for key in keys):
            notes.append("Drifts belong to a single recording, so they start from the data sheet.")
        fresh = [
            bounds[i].key
            for i in problem.free
            if bounds[i].key not in carried and not bounds[i].key.endswith(CLOCK_TERMS)
        ]
        return notes + (
            [f"New in this fit, with the data sheet's prior: {', '.join(fresh)}."] if fresh else []
        )

    def require_new(self, evidence: DataSplit) -> None:
        """FileError for another rig; DataError where a recording would count twice or is no longer
        unseen."""
        if self.rig not in [getattr(kind, "name", "") for kind in type(evidence.rig).__mro__]:
            raise FileError(
                f"{self.path} is a fit of the rig {self.rig!r}, not of {evidence.rig.name!r}.",
                "A fit can begin from a fit of the same rig, or of the rig that it derives from.",
            )
        for what, spans in (
            ("its data would count twice", evidence.fit),
            ("it cannot be held out", evidence.held_out),
        ):
            for span in spans:
                if span.recording.sha256 in self.fitted:
                    raise DataError(
                        f"{span.recording.path}: {self.path.parent} already uses this "
                        f"recording; {what}.",
                        "Give each recording to a single stage.",
                    )


def posterior_of(fitted: Fit) -> result.Posterior:
    """The part of fit.json that a later fit reads. covariance: lower triangle, row by row."""
    scale, bounds, free = (
        fitted.problem.scale,
        fitted.problem.assembly.parameters,
        list(fitted.problem.free),
    )
    others = {
        b.key: float(v)
        for i, (b, v) in enumerate(zip(bounds, reported_values(fitted), strict=True))
        if i not in free and not b.owner
    }
    return result.Posterior(
        keys=tuple(bounds[i].key for i in free),
        log=tuple(scale.log.tolist()),
        centre=tuple(scale.centre.tolist()),
        spread=tuple(scale.spread.tolist()),
        value=tuple(scale.inside(fitted.p[free]).tolist()),
        held=tuple(fitted.held.tolist()),
        others=others,
        covariance=tuple(tuple(row[: k + 1].tolist()) for k, row in enumerate(fitted.covariance)),
    )


def read_posterior(folder: Path) -> EarlierPosterior:
    """The posterior in a run's fit.json. FileError where it is damaged or too old, ConvergenceError
    where the fit never came to an end."""
    Run.open(folder)
    path = folder / FIT_FILE
    fit = need_result(path, result.FitFile, also=("posterior", "from"))
    # The Laplace approximation holds at an optimum. Away from it neither the mean nor the
    # covariance is that of a posterior.
    if not fit.converged:
        raise ConvergenceError(
            f"{path}: that fit did not converge ({fit.why or 'no reason given'}), so "
            "it cannot be the prior of another fit.",
            "Fit it with other recordings first.",
        )
    if (posterior := fit.posterior) is None:
        raise FileError(f"{path} holds no posterior.", f"An older version wrote it. {FIT_ANEW}")
    keys, rows = posterior.keys, posterior.covariance
    lower = np.zeros((len(keys), len(keys)))
    if [len(row) for row in rows] != list(range(1, len(keys) + 1)):
        _refuse(path, "its covariance is no lower triangle")
    lower[np.tril_indices(len(keys))] = [number for row in rows for number in row]
    fitted = {r.sha256 for r in fit.recordings if r.role != "held-out"}
    # A chain of fits rests on the recordings of all its stages.
    fitted |= set(fit.from_.recordings if fit.from_ else ())
    declared = [set(c.members) for c in fit.combinations.values() if c.declared]
    ridges = tuple(
        tie.parameters
        for tie in fit.tied
        if not any(members & set(tie.parameters) for members in declared)
    )
    lists = (posterior.log, posterior.centre, posterior.spread, posterior.value, posterior.held)
    sizes = {len(keys), len(set(keys)), *map(len, lists)}
    # Half of it is stored, which cannot become unsymmetric by an edit.
    covariance = lower + np.tril(lower, -1).T
    if len(sizes) > 1:
        _refuse(path, "its lists differ in length")
    narrow = any(spread <= 0.0 for spread in posterior.spread)
    if narrow or (keys and np.linalg.eigvalsh(covariance)[0] <= 0.0):
        _refuse(path, "a spread is not positive, or the covariance is none")
    return EarlierPosterior(
        path, sha256_of(path), fit.rig, posterior, covariance, frozenset(fitted), ridges
    )


def _refuse(path: Path, what: str) -> NoReturn:
    raise FileError(f"{path}: its posterior cannot be used: {what}.", FIT_ANEW, code="damaged")


def started_from(posterior: EarlierPosterior, remarks: list[str]) -> result.StartedFrom:
    """The entry `from` of fit.json: the earlier fit."""
    return result.StartedFrom(
        path=str(posterior.path.parent),
        sha256=posterior.sha256,
        recordings=tuple(sorted(posterior.fitted)),
        remarks=tuple(remarks),
    )
