"""`pamid reproduce-paper --paper arm`: what the twin hides, what the tests tell of it, and what the
table says."""

from __future__ import annotations

import contextlib
import io
import json
import math
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pamid_cli import frame

from pamid.base.json_file import read_json
from pamid.base.metrics import mae
from pamid.correction.force_map import read_map
from pamid.engine.program import Stepping
from pamid.model.assembly import Assembly
from pamid.model.registry import rig_named
from pamid.recording.recording import read_recording
from pamid.replications.arm_coupling import Uncoupled, stretches
from pamid.replications.arm_paper import AT_THE_FLOOR, FITTED, MAP_FILE, target_of
from pamid.replications.arm_twin import (
    DRY_FRICTION,
    GRAVITY_TEST,
    PULSES,
    VARIABLES,
    WITH_PAYLOAD,
    ArmTwin,
    sessions,
    shown_mae,
)
from pamid.replications.papers.arm import text as arm_text
from pamid.rigs.two_link import MUSCLES, TwoLink
from pamid.simulation.virtual_rig import simulate_virtual_rig

INERTIAL = {f"link_{j}_{what}" for j in "12" for what in ("mass_kg", "centre_m", "inertia_kg_m2")}
FREE, CLAMPED = "gravity-free-held-out", "gravity-clamped-held-out"
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


def test_what_is_hidden_is_of_the_size_that_was_said() -> None:
    shares = {
        name: value
        for name, value in asdict(ArmTwin()).items()
        if name not in ("law", "dry_friction_n_m")
    }
    sheet = {p.outside_name: p for p in rig_named("two-link").parameters}
    assert len({shares[name] for name in INERTIAL}) == len(INERTIAL)
    assert all(0.15 <= round(abs(shares[name] - 1.0), 9) <= 0.25 for name in INERTIAL)
    assert {shares[name] > 1.0 for name in INERTIAL} == {True, False}
    assert shares["viscous_1_n_m_s"] == shares["viscous_2_n_m_s"] == 1.5
    for name in shares.keys() - INERTIAL:
        p = sheet[name]
        away = math.log(shares[name]) if p.log else p.value * (shares[name] - 1.0)
        assert 0.0 < abs(away) < p.prior_spread, name
    assert ArmTwin().hidden()["link_1_mass_kg"] == pytest.approx(2.2 * 1.22)
    assert set(shares) == set(ArmTwin().hidden()) and ArmTwin().law != "exponential"


def test_dry_friction_stops_a_swing_away_from_the_middle() -> None:
    """The twin comes to rest within what friction can hold against gravity, and stays there."""
    session = sessions(12.0, MUSCLES, 0.003)[0]
    twin = ArmTwin()
    assert list(twin.friction) == [f"coulomb-friction@joint_{j}:torque_n_m" for j in "12"]
    still, swinging = (
        t.record(session, noise=0.0)["columns"]
        for t in (twin, replace(twin, dry_friction_n_m=(0.0, 0.0)))
    )
    assert np.ptp(still["angle_1_deg"][-300:]) < 0.01 < np.ptp(swinging["angle_1_deg"][-300:])
    moments = {q.outside_name: q.value for q in rig_named("two-link").parameters} | twin.hidden()
    second = moments["link_2_mass_kg"] * moments["link_2_centre_m"]
    own, bent = (math.radians(still[f"angle_{j}_deg"][-1]) for j in "12")
    torque = 9.81 * second * math.sin(own + bent)
    assert 0.0 < abs(torque) < 1.02 * twin.dry_friction_n_m[1]


@pytest.mark.parametrize("session", sessions(4.0, MUSCLES, 0.003)[:6], ids=lambda s: s.name)
def test_a_swing_is_one_without_actuation(session: Any) -> None:
    twin = ArmTwin()
    made = simulate_virtual_rig(
        f"two-link:{twin.law}", session.excitation, (), session.known, twin.hidden(), 0.0, 0
    ).columns
    assert max(np.abs(made[f"force_{i}_n"]).max() for i in MUSCLES) == 0.0
    assert np.ptp(made["angle_2_deg"]) > 20.0
    assert bool(np.ptp(made["angle_1_deg"])) == ("clamped" not in session.name)


def test_what_is_held_out_is_another_test() -> None:
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


def test_a_recording_tells_no_force_and_no_law() -> None:
    made = ArmTwin().record(sessions(4.0, MUSCLES, 0.003)[0])
    assert set(VARIABLES) < set(made["columns"]) and not any(
        c.startswith("force") for c in made["columns"]
    )
    assert made["meta"]["recording"]["rig"] == "two-link" and len(VARIABLES) == 10


def test_a_clamped_joint_is_not_scored() -> None:
    free = replace(sessions(4.0, MUSCLES, 0.003)[0].excitation, known={})
    clamped = replace(free, known={"clamped_1": 1.0})
    left = np.ones((len(free), len(VARIABLES)))
    found = shown_mae([(free, left), (clamped, 3.0 * left)])
    assert found["angle_1_deg"] == pytest.approx(math.degrees(1.0))
    assert found["angle_2_deg"] == pytest.approx(math.degrees(2.0))
    assert found["contraction_12"] == pytest.approx(100.0) and found[
        "contraction_21"
    ] == pytest.approx(200.0)
    assert found["pressure_11_kpa"] == pytest.approx(0.001)


# ---- a quick run --------------------


@pytest.fixture(scope="module", params=[pytest.param(None, marks=pytest.mark.slow)], ids=["quick"])
def quick(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    folder, said = tmp_path_factory.mktemp("paper") / "arm", io.StringIO()
    with contextlib.redirect_stdout(said):
        code = frame.run(
            ["reproduce-paper", "--paper", "arm", "--quick", "--json", "--output", str(folder)]
        )
    assert code == 0, said.getvalue()
    return folder, json.loads(said.getvalue())


def test_everything_is_written_and_said(quick: tuple[Path, dict[str, Any]]) -> None:
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


def test_the_fitted_arm_swings_as_the_twin_to_within_the_noise(
    quick: tuple[Path, dict[str, Any]],
) -> None:
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


def test_without_dry_friction_the_swings_are_missed(quick: tuple[Path, dict[str, Any]]) -> None:
    _, found = quick
    for j in "12":
        cells = found["mae"][GRAVITY_TEST][f"angle_{j}_deg"]
        assert cells["without_dry_friction"] > 5.0 * cells["noise_floor"]
        one = found["parameters"][f"coulomb-friction@joint_{j}:torque_n_m"]
        assert one["data_sheet"] == 0.0
        assert one["fitted_anfis"]["value"] == pytest.approx(one["truth"], rel=0.02)
        assert "without_dry_friction" not in found["mae"][PULSES][f"angle_{j}_deg"]


def test_the_coupling_is_what_the_uncoupled_arm_misses(quick: tuple[Path, dict[str, Any]]) -> None:
    folder, found = quick
    assert [one["moved"] for one in found["coupling"]] == ["angle_2_deg", "angle_1_deg"]
    for one in found["coupling"]:
        errors = one["mae"]
        assert one["swing_deg"] > 1.0
        assert errors["fitted"] < 1.1 * errors["noise_floor"]
        assert errors["without_coupling"] > 2.5 * errors["noise_floor"]
    assert "Coupling: the angle of a joint while only the other" in arm_text(found)
    r = read_recording(folder / "pulses-held-out.csv")
    for one, told in zip(stretches(r), found["coupling"], strict=True):
        assert (one.pulsed, one.angle) == (told["pulsed"], told["moved"])
        assert np.any(r.signal(f"command_{one.pulsed}")[one.rows])
        assert not np.any(r.signal(f"command_{one.moved}")[one.rows])
        assert told["from_s"] == r.time[one.rows][0] and told["to_s"] == r.time[one.rows][-1]


def test_uncoupled_joints_swing_each_for_itself() -> None:
    """In a horizontal plane, where gravity couples nothing, a torque on one joint leaves the other
    where it is; on the arm itself it does not."""
    moved = {}
    for rig in (Uncoupled(), TwoLink()):
        a = Assembly(rig)
        p = a.values({"plane_deg": 0.0, "vents_open": 1.0, "initial_angle_2_deg": 40.0})
        u = np.zeros((200, len(a.program.inputs)))
        u[:, a.program.inputs.index("external_torque_2_nm")] = 0.3
        y = a.program.run(
            a.program.memory(a.start(p), period_s=0.003),
            u,
            p,
            period_s=0.003,
            stepping=Stepping(2),
        )[0]
        moved[type(rig)] = np.ptp(y[:, :2], axis=0)
    assert moved[Uncoupled][0] < 1e-12 < 0.01 < moved[TwoLink][0]
    assert min(moved[Uncoupled][1], moved[TwoLink][1]) > 0.1


def test_the_figures_are_those_of_runs_by_hand(quick: tuple[Path, dict[str, Any]]) -> None:
    """The data sheet over the pulses, and what the gravity tests have told over the swings, without
    any fit."""
    folder, found = quick

    def error(name: str, variable: str, hidden: dict[str, float]) -> float:
        r = read_recording(folder / f"{name}.csv")
        dry = DRY_FRICTION if hidden.keys() & ArmTwin().friction.keys() else ()
        made = simulate_virtual_rig("two-link", r, dry, {}, hidden, 0.0, 0).columns
        return mae(r.signal(variable), made[variable])

    for variable in ("angle_2_deg", "pressure_22_kpa"):
        by_hand = error("pulses-held-out", variable, {})
        assert found["mae"][PULSES][variable]["data_sheet"] == pytest.approx(by_hand, rel=0.02)
    fitted = {k: v["gravity"]["value"] for k, v in found["parameters"].items()}
    cells = {
        v: found["mae"][GRAVITY_TEST][v]["fitted_anfis"] for v in ("angle_1_deg", "angle_2_deg")
    }
    assert cells["angle_1_deg"] == pytest.approx(error(FREE, "angle_1_deg", fitted), rel=0.01)
    both = np.mean([error(name, "angle_2_deg", fitted) for name in (FREE, CLAMPED)])
    assert cells["angle_2_deg"] == pytest.approx(both, rel=0.01)


def test_a_measured_law_alone_is_the_better_one(quick: tuple[Path, dict[str, Any]]) -> None:
    """In the pressures; in the angles the two are nearly as far off."""
    cells = quick[1]["mae"][PULSES]
    for variable in ("pressure_12_kpa", "pressure_21_kpa", "pressure_22_kpa"):
        one = cells[variable]
        assert 1.05 * one["noise_floor"] < one["anfis_alone"] < 0.8 * one["analytic_alone"], (
            variable
        )
        assert one["analytic_alone"] < 0.5 * one["data_sheet"], variable


def test_what_is_known_of_the_inertial_data(quick: tuple[Path, dict[str, Any]]) -> None:
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


def test_stages_begin_where_the_gravity_tests_ended(quick: tuple[Path, dict[str, Any]]) -> None:
    folder, _ = quick
    for name in ("pulses-analytic", "pulses-anfis", "pulses-anfis-alone"):
        told = read_json(folder / name / "fit.json")
        assert Path(told["from"]["path"]) == folder / "gravity"
        assert {r["name"] for r in told["recordings"]} == {"pulses", "pulses-held-out"}
    assert "from" not in read_json(folder / "gravity" / "fit.json")


def test_a_target_that_is_missed_is_said_to_be() -> None:
    cells = {
        v: {"unit": "deg", "noise_floor": 0.04, "fitted_analytic": 0.04, "fitted_anfis": 0.0421}
        for v in "ab"
    }
    missed = target_of({GRAVITY_TEST: cells})
    assert (
        not missed.reached
        and missed.worst == pytest.approx(1.0525)
        and missed.share == AT_THE_FLOOR
    )


@pytest.mark.parametrize(
    "option",
    [("--resume",), ("--jobs", "1"), ("--starts", "2"), ("--seconds", "20"), ("--iterations", "5")],
    ids=" ".join,
)
def test_options_of_the_joint_are_refused(
    option: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "arm"
    assert frame.run(["reproduce-paper", "--paper", "arm", *option, "--output", str(folder)]) == 2
    assert (
        f"{option[0]} says nothing to --paper arm" in capsys.readouterr().err
        and not folder.exists()
    )


def test_a_folder_that_is_taken(
    quick: tuple[Path, dict[str, Any]], capsys: pytest.CaptureFixture[str]
) -> None:
    assert (
        frame.run(["reproduce-paper", "--paper", "arm", "--quick", "--output", str(quick[0])]) == 3
    )
    assert "--overwrite" in capsys.readouterr().err
