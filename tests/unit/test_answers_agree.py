"""Whatever the losses of the candidates, an answer does not contradict its figures."""

from itertools import combinations

import numpy as np
import pytest
from made_models import comparison
from test_selection import BEFORE, EFFECTS, WINDOWS, Bench, Objecting

from pamid.base.schemas.diagnosis_file import CAUSED
from pamid.diagnosis.answer import Answer, answer, probability
from pamid.diagnosis.candidate_model import CandidateModel
from pamid.diagnosis.comparison import Comparison, families_of
from pamid.diagnosis.selection import Selection

NAMES = tuple(EFFECTS)


class DrawnBench(Bench):
    """Losses that differ from window to window, the same for the same effects."""

    spread = 0.0

    def made(self, names: tuple[str, ...]) -> CandidateModel:  # type: ignore[override]
        c = super().made(names)
        number = sum(2 ** NAMES.index(name) for name in names)
        random = np.random.default_rng(number)
        c.absolutes[:] *= random.lognormal(0.0, self.spread, (WINDOWS, 1))
        return c


def drawn(seed: int, patch: pytest.MonkeyPatch) -> tuple[Comparison, Selection, Answer]:
    """An answer where effects, alone and together, remove drawn shares; one is objected to."""
    random = np.random.default_rng(seed)
    levels = [[0.0, 0.05, 0.3, 0.32, 0.6, 0.9], [0.0, 0.6], [0.0, 0.0, 0.3]][seed % 3]
    alone = {name: random.choice(levels) for name in NAMES}
    together = np.max if random.random() < 0.4 else lambda kept: 1.0 - np.prod(1.0 - kept)
    shares = {}
    for size in (1, 2, 3):
        for names in combinations(NAMES, size):
            removed = float(together(np.array([alone[name] for name in names])))
            shares[names] = (1.0 - removed) * random.uniform(0.9, 1.1)
    objected = tuple(random.choice(NAMES, random.integers(2), replace=False))
    bench = DrawnBench(shares, Objecting(to=objected))
    bench.spread = random.choice([0.02, 0.1, 0.4, 1.2])
    selection = bench.selected(patch)
    found = comparison(BEFORE)
    ranking = found.ordered([bench.made((name,)) for name in NAMES])
    labels = [EFFECTS[name].label for name in objected]
    patch.setattr(Comparison, "predict_the_same", lambda *_: seed % 2 == 0)
    return found, selection, answer(found, selection, ranking, (), labels)


@pytest.mark.parametrize("seed", range(80))
def test_an_answer_agrees_with_its_figures(seed, monkeypatch):
    found, selection, a = drawn(seed, monkeypatch)
    settings = found.budget.settings
    rest = found.removed(a.model).rest.share
    assert (len(a.causes) > 0) == (a.verdict in CAUSED)
    if a.verdict == "explained":
        assert rest < settings.material_rest or found.floors(a.model) < 1.0 + settings.floor_margin
    if a.verdict == "partly-explained":
        assert rest >= settings.material_rest and a.left_over
    if a.verdict in ("explained", "partly-explained"):
        assert [c.effect for c in a.causes] == list(a.model.attached)
        families = [families_of(c.model) for c in a.causes]
        assert families, "every cause is part of the model"
        for c in a.causes:
            assert c.removes.share >= settings.material_share
            assert c.removes.z >= settings.standard_errors
            assert c.effect.label in selection.without
    if a.verdict == "ambiguous":
        best, *others = (c.model for c in a.causes)
        assert best is selection.best and others
        assert all(found.is_tied(c, best) for c in others)
        assert len({families_of(c.model) for c in a.causes}) == len(a.causes)
        assert seed % 2 == 0 or len(a.causes) <= settings.tied_most
    if a.verdict == "cannot-tell":
        assert a.model is found.budget.baseline
    assert all(0.0 < probability(c.figures) < 1.0 for c in a.causes)


def test_every_verdict_is_drawn(monkeypatch):
    """Else the test above says little."""
    verdicts = {drawn(seed, monkeypatch)[2].verdict for seed in range(80)}
    assert verdicts >= {"explained", "partly-explained", "ambiguous", "cannot-tell"}
