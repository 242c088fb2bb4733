"""`pamid reproduce-paper --paper arm`: what the twin hides, what the tests tell of it, and what the
table says."""

import contextlib
import io
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pamid_cli import frame

from pamid.api.replications.arm_twin import GRAVITY_TEST, PULSES, WITH_PAYLOAD, ArmTwin, sessions
from pamid.api.replications.papers.arm import FITTED, MAP_FILE
from pamid.api.replications.papers.arm import text as arm_text
from pamid.base.json_file import read_json
from pamid.model.registry import rig_named
from pamid.networks.correction.force_map import read_map
from pamid.rigs.two_link import MUSCLES

INERTIAL = {f"link_{j}_{what}" for j in "12" for what in ("mass_kg", "centre_m", "inertia_kg_m2")}
WRITTEN = (
    "run.json",
    "arm-paper.json",
    MAP_FILE,
    "figures/gravity.png",
    "figures/pulses.png",
    "figures/coupling.png",
    "law/rig.py",
    "law/network.npz",
    "gravity/fit.json",
    "gravity-without-payload/fit.json",
    "gravity-without-dry-friction/fit.json",
    "pulses-analytic-alone/fit.json",
    "pulses-anfis-alone/fit.json",
    "pulses-analytic/fit.json",
    "pulses-anfis/fit.json",
)


# ---- the twin --------------------


def test_what_is_held_out_is_another_test():
    planned = sessions(4.0, MUSCLES, 0.003)
    starts = [
        (s.known["initial_angle_1_deg"], s.known["initial_angle_2_deg"])
        for s in planned
        if s.kind == GRAVITY_TEST
    ]
    assert len(set(starts)) == len(starts) and [s.held_out for s in planned].count(True) == 3
    fitted, kept = (
        next(s for s in planned if s.kind == PULSES and s.held_out == held)
        for held in (False, True)
    )
    for name, sent in fitted.columns.items():
        assert np.abs(sent).max() == 1.0 and np.abs(kept.columns[name]).max() == 0.6
        assert not (sent.astype(bool) & kept.columns[name].astype(bool)).any()
    assert [s.name for s in planned if s.known.get("payload_kg")] == [WITH_PAYLOAD]


# ---- a quick run --------------------


@pytest.fixture(scope="module", params=[pytest.param(None, marks=pytest.mark.slow)], ids=["quick"])
def quick(tmp_path_factory) -> tuple[Path, dict[str, Any]]:
    folder, said = tmp_path_factory.mktemp("paper") / "arm", io.StringIO()
    with contextlib.redirect_stdout(said):
        code = frame.run(
            ["reproduce-paper", "--paper", "arm", "--quick", "--json", "--output", str(folder)]
        )
    assert code == 0, said.getvalue()
    return folder, json.loads(said.getvalue())


def test_everything_is_written_and_said(quick):
    folder, found = quick
    assert [name for name in WRITTEN if not (folder / name).is_file()] == []
    assert (
        found["schema"] == "pamid.paper-arm/1"
        and found["quick"]
        and found == read_json(folder / "arm-paper.json")
    )
    assert all(one["converged"] for one in found["fits"].values())
    assert read_json(folder / "run.json")["outcome"] == "done"
    text = arm_text(found)
    assert (
        text.startswith("QUICK") and "not the authors' arm" in text and "braid-and-rubber" in text
    )
    assert all(name in text for name in (*INERTIAL, "first_moment_1_kg_m", "pressure_22"))
    points = read_map(folder / MAP_FILE)
    assert len(points) == 6 * 21 and len(np.unique(points.contraction)) == 6


def test_the_fitted_arm_swings_as_the_twin_to_within_the_noise(quick):
    _, found = quick
    for kind in (GRAVITY_TEST, PULSES):
        for variable, cells in found["mae"][kind].items():
            if kind == GRAVITY_TEST or "pressure" in variable:
                assert all(cells[name] < 1.05 * cells["noise_floor"] for name in FITTED[2:]), (
                    kind,
                    variable,
                )
    angles = [found["mae"][GRAVITY_TEST][f"angle_{j}_deg"] for j in "12"]
    for cells in angles:
        assert cells["noise_floor"] == pytest.approx(0.05 * math.sqrt(2.0 / math.pi), rel=0.05)
        assert cells["data_sheet"] > 20.0 * cells["noise_floor"]
    assert found["target"]["reached"] and found["target"]["worst"] == pytest.approx(
        max(cells[name] / cells["noise_floor"] for cells in angles for name in FITTED[2:])
    )


def test_without_dry_friction_the_swings_are_missed(quick):
    _, found = quick
    for j in "12":
        cells = found["mae"][GRAVITY_TEST][f"angle_{j}_deg"]
        assert cells["without_dry_friction"] > 5.0 * cells["noise_floor"]
        one = found["parameters"][f"coulomb-friction@joint_{j}:torque_n_m"]
        assert one["data_sheet"] == 0.0
        assert one["fitted_anfis"]["value"] == pytest.approx(one["truth"], rel=0.02)
        assert "without_dry_friction" not in found["mae"][PULSES][f"angle_{j}_deg"]


def test_what_is_known_of_the_inertial_data(quick):
    _, found = quick
    p = {
        **{q.outside_name: q.value for q in rig_named("two-link").parameters},
        **ArmTwin().hidden(),
    }
    moment = {j: p[f"link_{j}_mass_kg"] * p[f"link_{j}_centre_m"] for j in "12"}
    about = {j: p[f"link_{j}_inertia_kg_m2"] + moment[j] * p[f"link_{j}_centre_m"] for j in "12"}
    length, mass = p["link_1_length_m"], p["link_2_mass_kg"]
    truth = {
        "first_moment_1_kg_m": moment["1"] + mass * length,
        "first_moment_2_kg_m": moment["2"],
        "inertia_about_joint_1_kg_m2": about["1"] + mass * length**2,
        "inertia_about_joint_2_kg_m2": about["2"],
    }
    assert found["combinations"].keys() == truth.keys()
    for name, value in truth.items():
        one = found["combinations"][name]
        assert one["truth"] == pytest.approx(value)
        for stage in (GRAVITY_TEST, *FITTED):
            known = one[stage]
            assert (
                known["value"] == pytest.approx(value, rel=0.005)
                and known["high"] - known["low"] < 0.01 * value
            )
        loose = one["without_payload"]
        assert loose["high"] - loose["low"] > 0.4 * value and loose["word"] == "weak"
    assert [set(tie["parameters"]) for tie in found["tied"]["fitted_anfis"]] == [INERTIAL]
    ratios = next(
        tie["known"]
        for tie in found["tied"]["without_payload"]
        if "link_1_mass_kg" in tie["parameters"]
    )
    assert len(ratios) == 3 and all(" / " in name for name in ratios)
    singles = {name: found["parameters"][name] for name in INERTIAL}
    assert {one["fitted_anfis"]["word"] for one in singles.values()} == {"weak"}
    for name in ("viscous_1_n_m_s", "viscous_2_n_m_s", "damping_m2_s"):
        one = found["parameters"][name]
        assert one["fitted_anfis"]["value"] == pytest.approx(one["truth"], rel=0.02), name
