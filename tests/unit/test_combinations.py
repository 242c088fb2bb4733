"""Parameters that only combinations of are known: what is named, and how well it is known."""

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from pamid_cli.fit import tied_text
from pendulum import TRUTH, Declared, Pendulum, swing

from pamid.estimation.fit_files import fit_json
from pamid.estimation.grey_box import GreyBox, fit_model
from pamid.model.registry import rig_named
from pamid.model.rig import Rig
from pamid.recording.recording import read_recording
from pamid.simulation.data_split import split_recordings

MOMENT = TRUTH["mass_kg"] * TRUTH["centre_m"]
ABOUT_JOINT = TRUTH["inertia_kg_m2"] + MOMENT * TRUTH["centre_m"]
INERTIAL = ("mass_kg", "centre_m", "inertia_kg_m2")


@cache
def fitted(torque: bool, declares: bool) -> GreyBox:
    rig: Rig = Declared() if declares else Pendulum()
    with TemporaryDirectory() as folder:
        return fit_model(
            split_recordings(rig, [swing(Path(folder) / "rec.csv", torque=torque)], [])
        )


def told(torque: bool, declares: bool) -> dict[str, Any]:
    return fit_json(fitted(torque, declares), 0)


def holds(one: dict[str, Any], truth: float, within: float) -> bool:
    """Is the truth in the interval (or a tenth of a per mil beside it: one in twenty is), and is
    that narrow?"""
    low, high = one["low"] - 1e-4 * truth, one["high"] + 1e-4 * truth
    return bool(low <= truth <= high and one["high"] - one["low"] < within * truth)


def test_a_known_torque_tells_moment_and_inertia_but_no_mass():
    found = told(True, True)
    assert {found["parameters"][n]["word"] for n in INERTIAL} == {"weak"}
    combos, (tie,) = found["combinations"], found["tied"]
    assert tuple(tie["parameters"]) == INERTIAL and tie["directions"] == 2
    assert set(tie["known"]) == {"first_moment_kg_m", "inertia_about_joint_kg_m2"}
    assert holds(combos["first_moment_kg_m"], MOMENT, 0.01)
    assert holds(combos["inertia_about_joint_kg_m2"], ABOUT_JOINT, 0.01)
    one = combos["inertia_about_joint_kg_m2"]
    assert (
        one["declared"]
        and one["word"] == "settled"
        and one["unit"] == "kg m2"
        and tuple(one["members"]) == INERTIAL
    )
    assert one["prior"] == pytest.approx(0.0075 + 0.7 * 0.13**2)


def test_without_a_declaration_a_product_of_powers_is_named():
    found = told(True, False)
    (tie,), combos = found["tied"], found["combinations"]
    assert tuple(tie["parameters"]) == INERTIAL and tie["directions"] == len(tie["known"]) == 2
    assert tie["known"][0] == "mass_kg x centre_m" and not combos["mass_kg x centre_m"]["declared"]
    assert holds(combos["mass_kg x centre_m"], MOMENT, 0.01)
    other = combos[tie["known"][1]]
    assert other["word"] == "settled" and (other["high"] - other["low"]) < 0.01 * other["value"]
    scale_free = told(False, False)
    assert any(n == "viscous_n_m_s / mass_kg / centre_m" for n in scale_free["tied"][0]["known"])


def test_parameters_that_are_known_by_themselves_are_not_tied():
    example = read_recording(Path(__file__).resolve().parents[2] / "data" / "example" / "joint.csv")
    found = fit_json(fit_model(split_recordings(rig_named("one-dof"), [example], [])), 0)
    assert found["tied"] == [] and tied_text(found) == []
