"""Contacts that MuJoCo drops, and whatever else it warns of, are counted and reported."""

from contextlib import nullcontext
from pathlib import Path
from typing import Any

import mechanisms
import numpy as np
import pandas as pd
import pytest
from pamid_cli import frame

import pamid
from pamid.base.arrays import Array
from pamid.base.json_file import read_json
from pamid.engine.program import Stepping
from pamid.engine.sampled_inputs import SampledInputs
from pamid.engine.simulator_warnings import SimulatorWarnings, add_warnings, counted_warnings
from pamid.model.assembly import Assembly
from pamid.model.registry import rig_named
from pamid.rigs.simulators.stepped_mechanism import SteppedMechanism
from pamid.simulation.excitation.aprbs import aprbs

mujoco: Any = mechanisms.needs_mujoco()


# a comb of spheres that lies on the ground: more contacts than there is memory for
COMB = """<mujoco model="comb">
  <compiler angle="radian"/>
  <option timestep="0.001" integrator="implicitfast"/>
  <size memory="{memory}"/>
  <worldbody>
    <geom name="ground" type="plane" size="5 5 0.1"/>
    <body name="comb" pos="0 0 0.11">
      <joint name="lift" type="slide" axis="0 0 1" damping="3"/>
      {teeth}
    </body>
  </worldbody>
  <actuator>
    <motor name="pull" joint="lift" gear="60" ctrllimited="true" ctrlrange="-1 1"/>
  </actuator>
  <sensor><jointpos name="height" joint="lift"/></sensor>
</mujoco>
"""
TEETH = "".join(
    f'<geom type="sphere" pos="{0.2 * (k % 8)} {0.2 * (k // 8)} 0" size="0.08" mass="0.05"/>'
    for k in range(40)
)
SMALL, LARGE = "12K", "4M"
PERIOD_S, SAMPLES = 0.004, 500


def comb(folder: Path, memory: str = SMALL) -> Path:
    path = folder / f"comb-{memory}.xml"
    path.write_text(COMB.format(memory=memory, teeth=TEETH))
    return path


def commands() -> Array:
    return 0.05 + 0.6 * aprbs(SAMPLES * PERIOD_S, PERIOD_S, 1.0, (0.1, 0.5), seed=1)


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    """Both combs, and a recording of one with memory for all contacts."""
    folder = tmp_path_factory.mktemp("comb")
    comb(folder)
    model = mujoco.MjModel.from_xml_path(str(comb(folder, LARGE)))
    data, read = mujoco.MjData(model), []
    for command in commands():
        read.append(float(data.qpos[0]))
        data.ctrl[0] = command
        mujoco.mj_step(model, data, 4)
    height = np.array(read) + 1e-4 * np.random.default_rng(0).standard_normal(SAMPLES)
    columns = {"time_s": PERIOD_S * np.arange(SAMPLES), "pull_command": commands()}
    pd.DataFrame(columns | {"height_m": height}).to_csv(folder / "rec.csv", index=False)
    return folder


def built(path: Path, *, in_c: bool) -> Assembly:
    """The model, stepped by MuJoCo's library or by its Python package."""
    rig = rig_named(str(path))
    assert isinstance(rig, SteppedMechanism)
    a = Assembly(rig)
    if not in_c:
        vars(rig._stepper)["mj_step"] = 0
    assert a.program.outputs  # what depends on what is tried by steps, too
    return a


def run_of(a: Assembly) -> Array:
    memory = a.program.memory(a.start(a.values()), period_s=PERIOD_S)
    u = commands()[:300, None]
    y, _, bad = a.program.run(memory, SampledInputs(u, PERIOD_S), a.values(), stepping=Stepping(1))
    assert bad < 0
    return y


@pytest.mark.parametrize("counting", [False, True])
def test_steps_go_on_behind_a_warning(place, counting):
    """A rollout ends there, and the rest of the exchange would be lost."""
    in_c, rolled = (built(place / f"comb-{SMALL}.xml", in_c=way) for way in (True, False))
    whole = run_of(in_c)
    with counted_warnings() if counting else nullcontext():
        found = run_of(rolled)
    assert np.abs(found - whole).max() < 1e-9


@pytest.mark.parametrize("in_c", [False, True])
def test_dropped_contacts_are_counted_as_mujoco_counts_them(place, in_c):
    path = place / f"comb-{SMALL}.xml"
    a = built(path, in_c=in_c)
    with counted_warnings() as warned:
        run_of(a)
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_WARMSTART)
    data = mujoco.MjData(model)
    for command in commands()[:300]:
        data.ctrl[0] = command
        mujoco.mj_step(model, data, 4)
    kinds = mujoco.mjtWarning
    full = kinds.mjWARN_CNSTRFULL, kinds.mjWARN_CONTACTFULL
    counts = [int(data.warning[int(kind)].number) for kind in full]
    assert warned.steps == 1200 and sum(counts) > 0
    found = [n for words, n in warned.counts.items() if "dropped" in words]
    # a solver that begins cold leads a hair elsewhere
    assert sorted(found) == pytest.approx(sorted(counts), abs=5)
    a = built(place / f"comb-{LARGE}.xml", in_c=in_c)
    with counted_warnings() as quiet:
        run_of(a)
    assert quiet.steps == 1200 and quiet.sentences("here") == ()


def test_nobody_counts_outside():
    counts, cures = {"a creak": 3, "smoke": 0}, {"a creak": "Oil it.", "smoke": "Run."}
    with counted_warnings() as first, counted_warnings() as second:
        add_warnings("Sim", 10, counts, cures)
    add_warnings("Sim", 10, counts, cures)
    assert first == second == SimulatorWarnings("Sim", 10, counts, cures)
    assert first.sentences("in a run") == ("Sim warned in a run (10 steps): a creak in 3. Oil it.",)


def test_check_fit_and_page_report_them(place, capsys, cli, undrawn):
    rig, rec = place / f"comb-{SMALL}.xml", place / "rec.csv"
    for words in (("check", rig), ("check", rec, "--rig", rig)):
        found = [f for f in cli(*words)["findings"] if f["check"] == "simulator"]
        assert len(found) == 1 and found[0]["advice"]
        assert "contacts dropped" in found[0]["detail"]
    run = place / "run"
    assert frame.run(["fit", str(rec), "--rig", str(rig), "--output", str(run)]) in (0, 5)
    assert "MuJoCo warned in free runs" in capsys.readouterr().out
    assert any("contacts dropped" in note for note in read_json(run / "fit.json")["notes"])
    assert frame.run(["report", str(run), "--rig", str(rig)]) == 0
    assert "contacts dropped" in (run / "report.html").read_text()


@pytest.mark.slow
def test_a_diagnosis_reports_them(place):
    found = pamid.diagnose(
        place / "rec.csv", place / f"comb-{SMALL}.xml", jobs=1, output=place / "diagnosed"
    )
    assert any("contacts dropped" in note for note in found.notes)
