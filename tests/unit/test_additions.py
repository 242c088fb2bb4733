"""The same effect in several joints as one candidate: which ports count as alike, where its
fits begin, and which of its ports are needed."""

from collections import defaultdict
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest
from made_models import comparison, effect, model

import pamid.diagnosis.selection as selection_module
from pamid.diagnosis.screening import ScreenedCandidate, starting_points
from pamid.diagnosis.selection import compared, with_needed_ports, with_plainer_effects
from pamid.model.assembly import Assembly
from pamid.model.attachment import Addition, additions_of, attachments, wholes_of
from pamid.model.effect import Hints, State
from pamid.model.registry import effects
from pamid.model.rig import Port, Rig

NO_HINTS: defaultdict[str, Hints] = defaultdict(Hints)


class Gantry(Rig):
    """Two rotary joints, a carriage and two couplings."""

    name = "gantry"
    inputs: ClassVar[dict[str, str]] = {"torque_nm": "N m"}
    outputs: ClassVar[dict[str, str]] = {"angle_rad": "rad"}
    states = (State("angle", "rad"), State("rate", "rad/s"))
    ports: ClassVar[dict[str, Port]] = {
        "base": Port("motion", "N m", ("velocity", "position")),
        "wrist": Port("motion", "N m", ("velocity", "position")),
        "carriage": Port("motion", "N", ("velocity", "position")),
        "coupling_1": Port("transmission", "N m", ("stretch",)),
        "coupling_2": Port("transmission", "N m", ("stretch",)),
    }

    def rates(self, x, u, p, port):
        torque = u.torque_nm
        for name in ("base", "wrist", "carriage"):
            torque = port(name, torque, velocity=x.rate, position=x.angle)
        for name in ("coupling_1", "coupling_2"):
            torque = port(name, torque, stretch=x.angle)
        return {"angle": x.rate, "rate": torque}

    def measure(self, x, u, p, port):
        return {"angle_rad": x.angle}


def additions(rig: Rig, *names: str) -> list[Addition]:
    named = [effects()[name] for name in names]
    return additions_of(rig, attachments(rig, named))


def test_ports_of_one_kind_and_unit_take_an_effect_together():
    labels = [a.label for a in additions(Gantry(), "coulomb-friction", "coupling-play")]
    assert labels == [
        "coulomb-friction@base + coulomb-friction@wrist",
        "coulomb-friction@carriage",
        # behind a transmission stands another machine
        "coupling-play@coupling_1",
        "coupling-play@coupling_2",
    ]


def test_candidates_grow_with_effects_not_with_joints():
    """Of two joints as many as of one."""
    rig = Gantry()
    one = [a for a in attachments(rig, effects().values()) if a.ports == ("base",)]
    both = [a for a in additions_of(rig, attachments(rig, effects().values())) if "base" in a.ports]
    assert len(one) == len(both) > 10 and all(a.ports == ("base", "wrist") for a in both)


def test_all_ports_begin_alike():
    rig = Gantry()
    (friction,) = additions(rig, "stribeck-friction")[:1]
    assembly = Assembly(rig, friction.members)
    (alone,) = additions_of(rig, friction.members[:1])
    points, hinted = starting_points(assembly, friction, NO_HINTS)
    single, _ = starting_points(Assembly(rig, alone.members), alone, NO_HINTS)
    assert hinted == [] and len(points) == len(single)
    for together, by_itself in zip(points, single, strict=True):
        assert by_itself.items() <= together.items()
        assert len(together) == 2 * len(by_itself)


# ---- which ports are needed --------------------------------------------------------------------

WINDOWS = 24
BEFORE = np.random.default_rng(0).uniform(9.0, 30.0, WINDOWS)
RUBS = [effect("coulomb-friction", "friction", f"joint_{k}") for k in range(1, 5)]
LEAK = effect("leak", port="chamber")


def leaving(share: float, *attached: Any) -> Any:
    return model(1.0 + share * (BEFORE - 1.0), *attached)


def reduced(
    monkeypatch: pytest.MonkeyPatch, needs: dict[int, float], certain: Sequence[int] = ()
) -> list[str]:
    """Ports that remain of friction at four joints. needs: what is left more without a joint's;
    certain: joints in the order of their certainty, the least first."""
    found = comparison(BEFORE)

    def refitted_with(search: Any, attached: Any, *_: Any) -> Any:
        left = sum(share for k, share in needs.items() if RUBS[k - 1] not in attached)
        return leaving(0.05 + left, *attached)

    def amount_z(model: Any, label: str) -> float:
        number = int(label[-1])
        return float(certain.index(number)) if number in certain else 99.0 + number

    for name, fake in (
        ("refitted_with", refitted_with),
        ("amount_z", amount_z),
        ("vanished", lambda model, label: ()),
    ):
        monkeypatch.setattr(selection_module, name, fake)
    best = with_needed_ports(SimpleNamespace(), found, leaving(0.05, *RUBS))  # type: ignore[arg-type]
    return [a.ports[0] for a in best.attached]


def test_joints_that_do_not_need_it_are_dropped(monkeypatch):
    assert reduced(monkeypatch, {1: 0.3, 3: 0.4}, (2, 4)) == ["joint_1", "joint_3"]
    assert reduced(monkeypatch, {2: 0.8}, (4, 1, 3)) == ["joint_2"]


def test_only_what_would_be_named_is_reduced():
    """It costs refits."""
    seen = []

    def reduce(c):
        seen.append(c.label)
        return leaving(0.05, RUBS[0]) if len(c.attached) > 1 else c

    guards: Any = SimpleNamespace(objections=lambda c: (), ignores_inputs=lambda c: False)
    found = comparison(BEFORE)
    both, leak = leaving(0.05, *RUBS[:2]), leaving(0.6, LEAK)
    step = compared(found, guards, found.budget.baseline, [both, leak], reduce)
    assert seen == [both.label] and [c.label for c in step.tied] == ["coulomb-friction@joint_1"]
    assert step.reduced == {both: step.tied[0]} and step.candidates == (step.tied[0], leak)


# ---- the plainest of a family ------------------------------------------------------------------


def screened(label: str, family: str, size: int, gain: float) -> Any:
    assembly = SimpleNamespace(parameters=[SimpleNamespace(fitted=True)] * size)
    added = SimpleNamespace(label=label, family=family)
    return SimpleNamespace(added=added, label=added.label, gain=gain, ended=(assembly, None))


def test_plainer_effects_of_a_family_that_would_be_named_are_refitted(monkeypatch):
    found, seen = comparison(BEFORE), []

    def refit_screened(search, base, chosen):
        seen.extend(s.added.label for s in chosen)
        return ["plain"], []

    monkeypatch.setattr(selection_module, "refit_screened", refit_screened)
    monkeypatch.setattr(selection_module, "_size", lambda a: len(getattr(a, "parameters", "12345")))
    named = model(1.0 + 0.1 * (BEFORE - 1.0), RUBS[0], parameters=9)
    object.__setattr__(named, "family", "friction")
    tried = [
        screened("coulomb-friction@joint_1", "friction", 3, 9.0),  # refitted already
        screened("plain", "friction", 2, 1.0),
        screened("as plain", "friction", 5, 2.0),
        screened("richer", "friction", 7, 50.0),
        screened("idle", "friction", 2, -1.0),
        screened("leak", "leak", 2, 9.0),
    ]
    from pamid.diagnosis.search import Round

    first = Round([named], [], None, tried)  # type: ignore[arg-type]
    search: Any = SimpleNamespace(
        budget=SimpleNamespace(baseline=found.budget.baseline), family=lambda a: a.family
    )
    assert with_plainer_effects(search, found, first).models == [named, "plain"]
    assert seen == ["plain", "as plain"]
    nothing = Round([leaving(1.0, RUBS[0])], [], None, tried)  # type: ignore[arg-type]
    assert with_plainer_effects(search, found, nothing) is nothing


class ThreeSensors(Gantry):
    """Three like readings of the angle."""

    name = "three-sensors"
    ports: ClassVar[dict[str, Port]] = {
        **Gantry.ports,
        **{f"reading_{k}": Port("reading", "rad", ("rate",)) for k in range(3)},
    }


def test_readings_of_a_unit_are_screened_together_first():
    rig = ThreeSensors()
    offered = additions(rig, "offset", "coulomb-friction", "coupling-play")
    wholes = wholes_of(rig, offered)
    assert [a.labels for a in wholes] == [tuple(f"offset@reading_{k}" for k in range(3))]


@pytest.mark.parametrize(("gain", "by_chance"), [(2.0, True), (30.0, False), (-np.inf, False)])
def test_members_are_left_out_where_the_whole_gains_by_chance(gain, by_chance):
    rig = ThreeSensors()
    whole = wholes_of(rig, additions(rig, "offset"))[0]
    assembly = Assembly(rig, whole.members)
    assert ScreenedCandidate(whole, assembly, {}, gain).by_chance == by_chance
