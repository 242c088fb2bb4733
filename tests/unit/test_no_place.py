"""Effects that a rig has no place for, while another rig for the same quantities has one."""

from pathlib import Path

import numpy as np
import pytest

import pamid
from pamid.model.attachment import attachments
from pamid.model.catalogue import rig_story, rig_text
from pamid.model.no_place import no_places
from pamid.model.registry import effects, rig_named, rigs
from pamid.model.rig import Rig
from pamid.recording.recording import recording_of

ROOT = Path(__file__).resolve().parents[2]


def lacking(rig: Rig) -> dict[str, tuple[str, ...]]:
    """Effect -> the rigs that have a place for it."""
    return {
        name: none.rigs
        for none in no_places(rig, effects().values(), rigs())
        for name in none.effects
    }


def test_a_motor_of_one_inertia_has_no_place_for_play_to_its_load():
    assert lacking(rig_named("dc-motor"))["coupling-play"] == ("geared-motor",)
    text = rig_text(rig_story(rig_named("dc-motor"), effects().values(), rigs()))
    assert "Effects without a port in this rig" in text
    assert "coupling-play (play in the coupling between two masses): geared-motor" in text


@pytest.mark.parametrize("name", ["geared-motor", "two-masses", "linear-axis", "thermal-block"])
def test_what_has_a_place_is_not_missed(name):
    """Nothing that fits is listed, and no smaller rig is offered to a larger one."""
    rig = rig_named(name)
    fit = {a.effect.name for a in attachments(rig, effects().values())}
    found = lacking(rig)
    assert not fit & set(found)
    for others in found.values():
        assert all(len(rigs()[other]().states) >= len(rig.states) for other in others)


def test_it_follows_from_ports_and_quantities_alone():
    """A rig of one's own is compared with those that take and read the same; with the port that an
    effect takes, it has a place."""
    cart = rig_named(str(ROOT / "data" / "rigs" / "cart.py"))
    assert lacking(cart)["load-dependent-friction"] == ("linear-axis", "two-masses")
    assert lacking(cart)["coupling-play"] == ("two-masses",)

    class Loaded(type(cart)):  # type: ignore[misc]
        ports = {
            **cart.ports,
            "force": pamid.Port("motion", "N", {"velocity": "m/s", "position": "m", "load": "N"}),
        }

    assert "load-dependent-friction" not in lacking(Loaded())

    class Other(type(cart)):  # type: ignore[misc]
        inputs = {"light_k": "K"}

    assert lacking(Other()) == {}  # nothing else takes that


def test_new_rig_states_it(tmp_path):
    levels = np.repeat(np.random.default_rng(1).uniform(-1.0, 1.0, 20), 20)
    given = recording_of(
        0.01 * np.arange(400), {"voltage_v": levels, "angle_deg": np.cumsum(levels)}, name="motor"
    )
    made = pamid.new_rig(given, like="dc-motor", output=tmp_path / "motor.py")
    assert "It has no port for coupling-play" in made.summary()
    assert "which geared-motor has." in made.summary()
