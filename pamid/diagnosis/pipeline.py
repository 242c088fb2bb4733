"""Diagnosis pipeline: baseline, latent evidence at the ports, screening, refits, comparison,
answer."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.base.parallel.jobs import WorkerPool
from pamid.base.progress import Progress, silent
from pamid.base.schemas.diagnosis_file import CAUSED, GapShare
from pamid.diagnosis.answer import Answer, answer
from pamid.diagnosis.budget import Budget, budget_of, gap_budget
from pamid.diagnosis.candidate_model import CandidateModel
from pamid.diagnosis.comparison import Comparison
from pamid.diagnosis.family_forms import free_forms
from pamid.diagnosis.guards import Guards
from pamid.diagnosis.input_response import explained_channels, following_channels, silent_channels
from pamid.diagnosis.search import Search, lower_baseline, opposite_signs, run_round
from pamid.diagnosis.selection import Selection, select_effects, with_plainer_effects
from pamid.diagnosis.settings import DEFAULT, Settings
from pamid.diagnosis.starting_hints import gather_hints
from pamid.estimation.lagged_linear import LaggedResponse, lagged_response
from pamid.estimation.port_evidence import PortEvidence, locate
from pamid.estimation.window_length import with_linear_windows
from pamid.model.attachment import Addition, additions_of, attachments
from pamid.model.determined_signals import determined
from pamid.model.effect import Effect
from pamid.model.rig import Port
from pamid.simulation.data_split import DataSplit, half_of_windows


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Result of a diagnosis.

    located: evidence at the ports before any effect is added; ranking: models of single effects,
    the lowest held-out loss first. If the recordings do not show this machine, or the baseline is
    at the noise floor, located, selection and answer are None and the ranking is empty.
    """

    evidence: DataSplit
    budget: Budget
    seed: int = 0
    silent: tuple[str, ...] = ()  # channels that do not show this machine: `silent_channels`
    response: LaggedResponse | None = (
        None  # linear response of outputs to inputs; None if no input moves
    )
    located: PortEvidence | None = None
    ranking: tuple[CandidateModel, ...] = ()
    # physical reasons for rejecting candidates of the ranking, by label
    set_aside: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    selection: Selection | None = None
    answer: Answer | None = None
    failed: tuple[tuple[str, str], ...] = ()  # candidates that could not be fitted, and why
    # models that remove much of the error with the opposite sign, and that share
    opposite: tuple[tuple[CandidateModel, float], ...] = ()
    # candidates whose signals the recordings do not determine, and the reason
    left_out: tuple[tuple[str, str], ...] = ()

    @property
    def verdict(self) -> str:
        if self.silent:
            return "cannot-tell"
        return self.answer.verdict if self.answer else "no-structural-gap"

    @property
    def cause(self) -> CandidateModel | None:
        """The model with the causes that the verdict names."""
        return self.answer.model if self.answer and self.verdict in CAUSED else None

    @property
    def left_over(self) -> bool:
        """Whether a material part of the gap remains, with or without causes."""
        return self.answer is not None and not self.silent and self.answer.left_over

    @property
    def settings(self) -> Settings:
        return self.budget.settings

    @cached_property
    def comparison(self) -> Comparison:
        return Comparison(self.budget, self.seed)

    @cached_property
    def half(self) -> NDArray[np.bool_]:
        """Mask of half of the held-out windows, for cross-validation."""
        base = self.budget.baseline
        return half_of_windows(list(base.replays), self.budget.channel_losses(base.absolutes))

    @cached_property
    def rivals(self) -> tuple[CandidateModel, ...]:
        """Models compared on the held-out windows: the answer and the candidates of all steps."""
        if self.selection is None:
            return ()
        models = (self.cause, *(c for step in self.selection.steps for c in step.candidates))
        return tuple(dict.fromkeys(c for c in models if c is not None))

    def reported(self, model: CandidateModel) -> Array:
        """Errors of a model per held-out window and channel (SI). Those of the answer are
        cross-validated: each half is scored with the model chosen on the other half."""
        if model is not self.cause or len(self.rivals) < 2:
            return model.absolutes
        errors = model.absolutes.copy()
        size = len(model.additions)
        rivals = [c for c in self.rivals if len(c.additions) == size]
        for half in (self.half, ~self.half):
            if half.any() and not half.all():
                losses = [self.comparison.loss(c)[~half].sum() for c in rivals]
                errors[half] = rivals[int(np.argmin(losses))].absolutes[half]
        return errors

    @cached_property
    def removed(self) -> GapShare | None:
        """Cross-validated share of the gap that the causes remove together."""
        if self.cause is None:
            return None
        losses = self.budget.channel_losses(self.reported(self.cause))
        return self.comparison.removed(self.cause, losses=losses)

    @property
    def left_at(self) -> PortEvidence | None:
        """Evidence at the ports with the causes modelled; without causes, that of the baseline."""
        return self.selection.after if self.selection and self.cause else self.located

    @property
    def nameless_at(self) -> list[str]:
        """Ports at any of which an unknown effect enters. These are the ports of nonparametric
        curves that absorb it, or else the inseparable ports with the largest latent evidence."""
        forms = self.answer.free_forms if self.answer else ()
        form_ports = dict.fromkeys(f.attachment.ports[0] for f in forms)
        return list(form_ports or (self.left_at.classes[0] if self.left_at else ()))


def diagnose(
    evidence: DataSplit,
    catalogue: dict[str, type[Effect]],
    *,
    seed: int = 0,
    jobs: int = 1,
    progress: Progress = silent,
    pool: WorkerPool | None = None,
    settings: Settings = DEFAULT,
) -> Diagnosis:
    """Find where the gap lies, which effect causes it and how far it shrinks.

    Parameters
    ----------
    evidence
        Recordings of a rig, divided into a fitted and a held-out part.
    catalogue
        Effects by name.
    seed
        Seed of all random draws.
    jobs
        Number of processes on this machine, unless `pool` is given.
    progress
        Callback for progress messages.
    pool
        Workers for the fits.
    settings
        Thresholds, counts and times (see `pamid.diagnosis.settings`).
    """
    pool = pool or WorkerPool(jobs)
    # The cost grows with the length of the data, the certainty only with its square root.
    evidence = with_linear_windows(evidence.excerpt(settings.fitted_most, settings.held_out_most))
    budget = gap_budget(evidence, seed=seed, pool=pool, progress=progress, settings=settings)
    return _diagnosis_from(budget, catalogue, seed, pool, progress)


def _diagnosis_from(
    budget: Budget,
    catalogue: dict[str, type[Effect]],
    seed: int,
    pool: WorkerPool,
    progress: Progress,
) -> Diagnosis:
    """Diagnosis that begins with this baseline; again, where an effect leads the baseline out of a
    local minimum."""
    evidence, settings = budget.evidence, budget.settings  # with the horizon of the comparison
    base, comparison = budget.baseline, Comparison(budget, seed)
    response = lagged_response(evidence, base.assembly)
    explained = explained_channels(budget, base, response, seed)
    silent = silent_channels(budget, base, explained, response)
    # If neither the model nor a lagged linear response predicts any channel, we do not search: an
    # effect could reproduce the recordings only without the inputs. A single unpredicted channel
    # may just lack an effect. A joint held by friction, for example, follows neither a model
    # without friction nor a linear model.
    unpredictable = silent and response is not None and bool(response.absent.all())
    if comparison.at_floor(base) or (unpredictable and not following_channels(budget, base).any()):
        return Diagnosis(evidence, budget, seed, silent, response)
    usable, left_out = determined(
        evidence.rig,
        evidence.channels,
        evidence.still_inputs,
        attachments(evidence.rig, catalogue.values()),
    )
    candidates = additions_of(evidence.rig, usable)
    search = Search(
        evidence,
        budget,
        candidates,
        gather_hints(evidence, base),
        seed,
        pool,
        progress,
        response,
    )
    progress("looking where something is missing")
    # Locate before any effect is tried: the location must not depend on the catalogue.
    located = locate(evidence, base, pool, alike=settings.port_alike)
    to_screen = candidates_to_screen(candidates, evidence.rig.ports, located, settings)
    first_round = with_plainer_effects(search, comparison, run_round(search, base, to_screen))
    refitted = lower_baseline(search, comparison, comparison.ordered(first_round.models))
    if refitted is not None:
        progress("the baseline had ended in a local minimum; beginning again")
        lower = budget_of(refitted, seed=seed, progress=progress, settings=settings)
        return _diagnosis_from(lower, catalogue, seed, pool, progress)
    guards = Guards(search)
    selection = select_effects(search, comparison, guards, located, first_round)
    reduced = selection.steps[0].reduced
    ranking = comparison.ordered([reduced.get(c, c) for c in first_round.models])
    # A wrong sign of a port is a fault of the set-up. We consider it only if no effect explains the
    # gap.
    opposite = [] if selection.best.attached else opposite_signs(search, ranking)
    progress("looking for the family of what remains")
    remaining_share = comparison.removed(selection.best).rest.share
    material = remaining_share >= settings.material_rest and not comparison.at_floor(selection.best)
    ports = list(selection.after.classes[0]) if material else []
    forms = free_forms(search, comparison, selection.best, ports)
    set_aside = {c.label: why for c in ranking if (why := guards.objections(c))}
    decision = answer(comparison, selection, ranking, forms, set_aside)
    # The best model, named or not, decides whether the recordings show this machine.
    best, leader = decision.model, decision.leader
    if leader and not decision.causes and comparison.removed(leader).share > 0.0:
        best = leader
    explained = explained_channels(budget, best, response, seed)
    return Diagnosis(
        evidence,
        budget,
        seed,
        silent_channels(budget, best, explained, response),
        response,
        located,
        tuple(ranking),
        set_aside,
        selection,
        decision,
        tuple(first_round.failed),
        tuple(opposite),
        tuple(left_out.items()),
    )


def candidates_to_screen(
    candidates: list[Addition],
    ports: Mapping[str, Port],
    located: PortEvidence,
    settings: Settings = DEFAULT,
) -> list[Addition]:
    """Return the candidates to screen.

    Up to `held_background_from` candidates are all screened. Of more, we screen those at the ports
    with the largest latent evidence among the ports of their kind. Evidence selects between joints,
    but not between a motor and its gear: a slowly varying value cannot mimic play in a stiff gear.
    """
    if len(candidates) <= settings.held_background_from:
        return candidates
    best_gain: dict[str, float] = {}
    for name, gain in located.gains.items():
        best_gain[ports[name].kind] = max(gain, best_gain.get(ports[name].kind, 0.0))

    def reaches(name: str) -> bool:
        return located.gains[name] >= settings.port_reach * best_gain[ports[name].kind]

    return [a for a in candidates if any(map(reaches, a.ports))]
