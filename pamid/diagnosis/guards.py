"""Physical reasons for which a model is set aside, however well it predicts.

A parameter ended at a bound that physics did not set; an amount ended at nothing, so that the model
is a plainer one; the effect duplicates a term of the rig; the effect switches the input off.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from pamid.diagnosis.candidate_model import CandidateModel
from pamid.diagnosis.input_response import explained_channels
from pamid.diagnosis.own_terms import own_terms
from pamid.diagnosis.ranges import at_bounds, vanished
from pamid.diagnosis.search import Search


@dataclass(frozen=True, eq=False)
class Guards:
    """Objections to the models of one search."""

    search: Search
    _objections: dict[CandidateModel, tuple[str, ...]] = field(default_factory=dict)

    def objections(self, model: CandidateModel) -> tuple[str, ...]:
        """Why a model may not be named; empty where nothing speaks against it."""
        if model not in self._objections:
            self._objections[model] = tuple(self._found(model))
        return self._objections[model]

    def _found(self, model: CandidateModel) -> list[str]:
        found = []
        settings, base = self.search.settings, self.search.budget.baseline
        for a in model.attached:
            if ended := at_bounds(model, settings, a.label):
                found.append(f"{', '.join(ended)} of {a.label} ended at a bound")
            if gone := vanished(model, a.label):
                found.append(f"{', '.join(gone)} of {a.label} ended at nothing")
            if terms := own_terms(model, a.label, base, settings):
                found.append(f"{a.label} does what {', '.join(terms)} of the rig does")
        return found

    def ignores_inputs(self, model: CandidateModel) -> bool:
        """Whether a model explains no channel by its inputs, to which the outputs respond."""
        search, reason = self.search, "it predicts no better with the recorded inputs than without"
        if reason in self.objections(model):
            return True
        ignores = not explained_channels(search.budget, model, search.response, search.seed).any()
        if ignores:
            self._objections[model] = (*self.objections(model), reason)
        return ignores
