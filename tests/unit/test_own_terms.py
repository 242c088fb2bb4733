"""An effect that does what a parameter of the rig does already is no missing effect."""

from dataclasses import replace

import numpy as np
import pytest
from small_cart import PERIOD_S, record_cart

from pamid.diagnosis.candidate_model import CandidateModel, candidate_from, refit, replayed
from pamid.diagnosis.guards import _acting_elsewhere, duplicated_terms
from pamid.diagnosis.settings import DEFAULT
from pamid.estimation.grey_box import fit_model, model_with
from pamid.model.attachment import attach
from pamid.model.background import RoughMap
from pamid.model.effect import Effect, State
from pamid.model.parameter import Parameter
from pamid.model.registry import catalogue_rig, effects, rigs
from pamid.model.rig import Port, Rig
from pamid.recording.recording import read_recording
from pamid.simulation.data_split import DataSplit, split_recordings


class DraggedCart(Rig):
    """A cart whose rig knows of its drag, and passes both through one port."""

    inputs = {"force_n": "N"}
    outputs = {"position_m": "m"}
    ports = {
        "force": Port("motion", "N", signals={"velocity": "m/s", "position": "m"}),
        "sensor": Port("reading", "m"),
    }
    background = {"force": RoughMap("force_map", "position", tolerance=0.02)}
    states = (State("position", "m"), State("velocity", "m/s"))
    parameters = (
        Parameter("mass", 1.0, 0.1, 10.0, "kg", spread=1.5, log=True, source="kitchen scale"),
        Parameter("drag", 3.0, 0.0, 30.0, "N s/m", spread=3.0, source="guess"),
    )
    period_s = PERIOD_S
    noise = {"position_m": 1e-5}

    def rates(self, x, u, p, port):
        force = u.force_n - p.drag * x.velocity
        force = port("force", force, velocity=x.velocity, position=x.position)
        return {"position": x.velocity, "velocity": force / p.mass}

    def measure(self, x, u, p, port):
        return {"position_m": port("sensor", x.position)}


class CreepingDrag(Effect):
    """Drag that wears off while it lasts: more than the drag of the rig, by what it remembers."""

    name = "creeping-drag"
    family = "friction"
    kinds = ("motion",)
    signals = ("velocity",)
    unit = "N"
    states = (State("given", "N"),)
    parameters = (
        Parameter("drag", 3.0, 0.0, 30.0, "N s/m", spread=3.0, null=0.0, source="test"),
        Parameter("time_constant", 0.3, 0.01, 3.0, "s", spread=2.0, log=True, source="test"),
    )

    def act(self, value, at, p, z):
        return value - p.drag * at.velocity + z.given / p.time_constant, {
            "given": p.drag * at.velocity - z.given / p.time_constant
        }


@pytest.fixture(scope="module")
def recorded(tmp_path_factory) -> tuple[DataSplit, CandidateModel]:
    path = record_cart(
        tmp_path_factory.mktemp("dragged"), planted=("viscous-friction:damping_n_s_per_m=3.4",)
    )
    told = read_recording(path)
    evidence = split_recordings(DraggedCart(), [told], [])
    model = fit_model(evidence)
    return evidence, candidate_from(model.assembly, model.fit, model.held_out)


def duplicated(
    recorded: tuple[DataSplit, CandidateModel], name: str, **amounts: float
) -> tuple[str, ...]:
    """Terms of the rig that an effect of these amounts (SI) duplicates, not fitted."""
    evidence, base = recorded
    effect = attach(evidence.rig, name, effects() | {CreepingDrag.name: CreepingDrag})
    assembly = model_with(evidence, (effect,), base.assembly.sizes)
    fitted = refit(evidence, assembly, base.fit)
    p = np.array(fitted.p)
    for key, value in amounts.items():
        p[assembly.keys[f"{name}:{key}"]] = value
    model = replayed(evidence, assembly, replace(fitted, p=p))
    return duplicated_terms(model, name, base, DEFAULT)


@pytest.mark.parametrize(
    ("name", "amounts"),
    [
        ("viscous-friction", {"damping": 4.0}),
        ("directional-damping", {"forward": 4.0, "backward": 4.02}),
    ],
)
def test_drag_once_more_is_told(recorded, name, amounts):
    assert duplicated(recorded, name, **amounts) == ("drag_n_s_per_m",)


@pytest.mark.parametrize(
    ("name", "amounts"),
    [
        ("coulomb-friction", {"level": 0.5, "give": 1e-4}),
        ("directional-damping", {"forward": 4.0, "backward": 6.0}),
        ("quadratic-drag", {"drag": 4.0}),
        ("cubic-stiffness", {"hardening": 1.0}),
        ("creeping-drag", {"drag": 4.0, "time_constant": 0.2}),
    ],
)
def test_what_no_parameter_of_the_rig_does_is_an_effect(recorded, name, amounts):
    assert duplicated(recorded, name, **amounts) == ()


@pytest.mark.parametrize("name", list(rigs()))
def test_every_rig_is_asked_what_acts_beside_its_ports(name):
    """Also where nothing may pass a port without dividing by zero."""
    rig = catalogue_rig(name)
    assert set(_acting_elsewhere(rig)) == set(rig.ports)
