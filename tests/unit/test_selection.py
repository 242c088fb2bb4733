"""Effects added step by step, with made-up losses in the place of refits."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from made_models import RIG, comparison, effect, model

import pamid.diagnosis.selection as selection_module
from pamid.diagnosis.candidate_model import CandidateModel
from pamid.diagnosis.selection import Selection, compared, select_effects
from pamid.estimation.port_evidence import PortEvidence
from pamid.model.attachment import Addition

WINDOWS = 24
BEFORE = np.random.default_rng(0).uniform(9.0, 30.0, WINDOWS)
EFFECTS = {
    "friction": effect("coulomb-friction", "friction"),
    "lugre": effect("lugre-friction", "friction"),
    "leak": effect("leak", port="chamber"),
    "delay": effect("dead-time", port="command"),
    "drag": effect("quadratic-drag", "drag"),
}
EVERY = ("friction", "leak", "delay", "drag")
NOWHERE = PortEvidence({}, (), {}, {})


def leaving(share: float, *names: str, parameters: int = 0) -> CandidateModel:
    """A model that leaves this share of the gap in every window."""
    attached = [EFFECTS[name] for name in names]
    return model(1.0 + share * (BEFORE - 1.0), *attached, parameters=parameters)


@dataclass
class Objecting:
    """Guards that object to models with these effects. idle: effects that switch the input off."""

    to: tuple[str, ...] = ()
    idle: tuple[str, ...] = ()

    def objections(self, c: CandidateModel) -> tuple[str, ...]:
        return tuple(a.label for a in c.attached if a in [EFFECTS[name] for name in self.to])

    def ignores_inputs(self, c: CandidateModel) -> bool:
        return any(a in [EFFECTS[name] for name in self.idle] for a in c.attached)


@dataclass
class Bench:
    """What refits would leave of the gap, by effects; a set that is not listed leaves 1."""

    shares: dict[tuple[str, ...], float]
    guards: Objecting = field(default_factory=Objecting)
    refitted: list[str] = field(default_factory=list)
    candidates: list[Addition] = field(default_factory=list)
    finer: Callable[[CandidateModel], CandidateModel] = lambda c: c

    def made(self, names: Sequence[str]) -> CandidateModel:
        shares = {frozenset(key): share for key, share in self.shares.items()}
        return leaving(shares.get(frozenset(names), 1.0), *names)

    def selected(self, monkeypatch: pytest.MonkeyPatch) -> Selection:
        found = comparison(BEFORE)
        names = {id(a): name for name, a in EFFECTS.items()}

        def refitted_with(search: Any, attached: Any, *sources: Any) -> CandidateModel:
            self.refitted.append(" + ".join(names[id(a)] for a in attached))
            return self.made([names[id(a)] for a in attached]) if attached else base

        def larger(search: Any, best: CandidateModel, *_: Any) -> list[CandidateModel]:
            size = max(len(best.attached) + 1, 2)
            return [self.made(key) for key in self.shares if len(key) == size]

        base = found.budget.baseline
        for name, fake in (
            ("refitted_with", refitted_with),
            ("_larger", larger),
            ("with_finer_steps", lambda search, c: self.finer(c)),
            ("locate", lambda *_, **__: NOWHERE),
            ("responses_of", lambda *_: None),
        ):
            monkeypatch.setattr(selection_module, name, fake)
        search: Any = SimpleNamespace(
            settings=found.budget.settings,
            budget=found.budget,
            evidence=None,
            pool=None,
            progress=lambda text: None,
            family=lambda a: a.family(RIG),
            candidates=self.candidates,
        )
        first: Any = SimpleNamespace(
            models=[self.made(key) for key in self.shares if len(key) == 1],
            reference=None,
            screened=[],
        )
        return select_effects(search, found, cast(Any, self.guards), NOWHERE, first)


def names_of(c: CandidateModel) -> list[str]:
    by_label = {a.label: name for name, a in EFFECTS.items()}
    return [by_label[a.label] for a in c.attached]


def test_a_single_effect_that_explains_the_gap_ends_the_search(monkeypatch):
    bench = Bench({("friction",): 0.1, ("leak",): 0.6, ("friction", "leak"): 0.0})
    found = bench.selected(monkeypatch)
    assert names_of(found.best) == ["friction"] and len(found.steps) == 1
    assert found.without[found.best.attached[0].label].label == "baseline"


def test_ports_are_dropped_at_the_final_integration_steps(monkeypatch):
    """Coarse steps move the shares by some percent, which would keep a port that adds nothing."""
    finer, fewer = leaving(0.12, "friction", parameters=2), leaving(0.12, "friction")

    def with_needed_ports(search: Any, found: Any, whole: CandidateModel) -> CandidateModel:
        return fewer if whole is finer else whole

    monkeypatch.setattr(selection_module, "with_needed_ports", with_needed_ports)
    bench = Bench({("friction",): 0.1}, finer=lambda c: finer)
    assert bench.selected(monkeypatch).best is fewer


def test_a_second_effect_is_added_where_much_remains(monkeypatch):
    bench = Bench({("friction",): 0.5, ("leak",): 0.7, ("friction", "leak"): 0.1})
    found = bench.selected(monkeypatch)
    assert names_of(found.best) == ["friction", "leak"]
    assert [names_of(step.reference) for step in found.steps] == [[], ["friction"]]
    assert {key: names_of(c) for key, c in found.without.items()} == {
        "coulomb-friction@joint": ["leak"],
        "leak@chamber": ["friction"],
    }


@pytest.mark.parametrize(
    ("shares", "best"),
    [
        # a second effect that adds little
        ({("friction",): 0.5, ("friction", "leak"): 0.4}, ["friction"]),
        # neither helps alone
        ({("friction",): 0.95, ("leak",): 1.1, ("friction", "leak"): 0.1}, ["friction", "leak"]),
        # drag stood for a leak and a delay; next to both it is idle
        (
            {
                ("drag",): 0.5,
                ("leak",): 0.6,
                ("delay",): 0.7,
                ("drag", "leak"): 0.3,
                ("leak", "delay"): 0.02,
                ("drag", "leak", "delay"): 0.02,
            },
            ["leak", "delay"],
        ),
        # three at most
        ({EVERY[:k]: 1.0 - 0.2 * k for k in (1, 2, 3, 4)}, list(EVERY[:3])),
    ],
    ids=["adds little", "pair", "stand-in", "three"],
)
def test_effects_stay_that_are_needed(shares, best, monkeypatch):
    found = Bench(shares).selected(monkeypatch)
    assert sorted(names_of(found.best)) == sorted(best)
    if best == ["friction"]:
        assert len(found.steps) == 2 and found.steps[1].tied == ()


def test_the_way_out_of_a_local_minimum_is_kept(monkeypatch):
    """Friction ended at 50 %; refitted after a leak had been added and removed it leaves 5 %."""
    bench = Bench({("friction",): 0.5, ("friction", "leak"): 0.05})
    first = bench.made

    def better_when_refitted(names):
        return (
            leaving(0.05, *names)
            if bench.refitted and list(names) == ["friction"]
            else first(names)
        )

    monkeypatch.setattr(bench, "made", better_when_refitted)
    found = bench.selected(monkeypatch)
    assert names_of(found.best) == ["friction"]
    assert comparison(BEFORE).removed(found.best).share == pytest.approx(0.95)
    assert found.instead["coulomb-friction@joint"] == ()


def test_families_that_tie_are_held_against_each_other(monkeypatch):
    bench = Bench({("friction",): 0.10, ("leak",): 0.11, ("lugre",): 0.10, ("delay",): 0.4})
    found = bench.selected(monkeypatch)
    assert [names_of(c) for c in found.steps[0].tied] == [["friction"], ["leak"]]
    (others,) = found.instead.values()
    assert [names_of(c) for c in others] == [["leak"]], "one model of each further family"


def test_in_the_place_of_one_of_two_causes_stands_what_does_as_well_next_to_the_other(monkeypatch):
    bench = Bench(
        {
            ("friction",): 0.5,
            ("friction", "leak"): 0.10,
            ("friction", "delay"): 0.11,
            ("friction", "drag"): 0.3,
        }
    )
    found = bench.selected(monkeypatch)
    assert names_of(found.best) == ["friction", "leak"]
    instead = {key: [names_of(c) for c in models] for key, models in found.instead.items()}
    assert instead == {"coulomb-friction@joint": [], "leak@chamber": [["friction", "delay"]]}
    assert "friction + delay" not in bench.refitted, "it is fitted already"


# ---- guards -------------------------------------------------------------------------------------


def step(guards: Objecting, *models: CandidateModel) -> Any:
    found = comparison(BEFORE)
    return compared(found, cast(Any, guards), found.budget.baseline, models)


@pytest.mark.parametrize("guards", [Objecting(to=("friction",)), Objecting(idle=("friction",))])
def test_a_model_that_is_objected_to_or_ignores_its_inputs_makes_room(guards):
    best, next_best = leaving(0.1, "friction"), leaving(0.4, "leak")
    assert step(Objecting(), best, next_best).tied == (best,)
    made = step(guards, best, next_best)
    assert made.tied == made.candidates == (next_best,)


def test_candidates_are_material_and_ordered_by_loss():
    models = [leaving(share, name) for share, name in ((0.95, "drag"), (0.5, "leak"))]
    best = leaving(0.3, "friction")
    made = step(Objecting(), *models, best)
    assert made.candidates == (best, models[1])
    assert replace(made, tied=()).reference is made.reference
