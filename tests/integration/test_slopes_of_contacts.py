"""A sled that is pushed and rocked along a floor: its contacts open and close in every other
step."""

import numpy as np
import pandas as pd
import pytest

import pamid
from pamid.engine.program import Stepping
from pamid.engine.sampled_inputs import SampledInputs
from pamid.estimation.grey_box import model_with
from pamid.estimation.observed_sizes import observed_sizes
from pamid.estimation.problem import Problem, free_parameters
from pamid.estimation.robust_fit import fit_robustly
from pamid.model.assembly import Assembly
from pamid.model.registry import rig_named
from pamid.simulation.data_split import split_recordings
from pamid.simulation.excitation.aprbs import aprbs

pytest.importorskip("mujoco", reason="the extra [mujoco] is not installed")

SLED = """<mujoco model="sled">
  <compiler angle="radian"/>
  <option timestep="0.002" integrator="RK4"/>
  <worldbody>
    <geom name="floor" type="plane" size="50 50 0.1" margin="0.001"/>
    <body name="sled" pos="0 0 0.0605">
      <joint name="along" type="slide" axis="1 0 0"/>
      <joint name="up" type="slide" axis="0 0 1"/>
      <joint name="pitch" axis="0 1 0"/>
      <geom type="capsule" fromto="-0.13 0 0 0.26 0 0" size="0.06" mass="1" friction="0.9"
            solimp="0.8 0.8 0.01" margin="0.001"/>
    </body>
  </worldbody>
  <actuator>
    <motor name="push" joint="along" gear="20"/>
    <motor name="tilt" joint="pitch" gear="2"/>
  </actuator>
</mujoco>
"""
PERIOD, SECONDS = 0.008, 8.0
COMMANDS = np.stack([aprbs(SECONDS, PERIOD, 1.0, (0.2, 0.8), seed=1 + i) for i in range(2)], axis=1)
MASS = 1.2  # of the sled that is recorded; the file says 1 kg


@pytest.fixture
def assembly(tmp_path) -> Assembly:
    path = tmp_path / "sled.xml"
    path.write_text(SLED)
    return Assembly(rig_named(str(path)))


def test_a_disturbance_does_not_grow_by_contacts_that_open_and_close(assembly):
    """Slopes across the jumps of contacts, multiplied up along a window, would reach 1e41."""
    p, n = assembly.values(), len(assembly.rig.states)
    memory = assembly.program.memory(assembly.start(p), n, period_s=PERIOD)
    memory.S[:n, :n] = np.eye(n)
    columns = np.full(len(p), -1, np.int64)
    grown = []
    for k in range(len(COMMANDS)):
        *_, bad = assembly.program.run(
            memory,
            SampledInputs(COMMANDS[k : k + 1], PERIOD),
            p,
            stepping=Stepping(1),
            columns=columns,
        )
        assert bad < 0
        # in the units of the states in which it is least: the Perron root of the sizes
        grown.append(np.abs(np.linalg.eigvals(np.abs(memory.S[:n, :n]))).max())
    assert max(grown) < 100.0


@pytest.mark.slow
def test_a_mass_is_found_on_the_floor(assembly):
    """By slopes across jumps a fit ends where it begins, at 1 kg. In which order of impacts it
    settles rests on noise and a machine's last bits: 1.12 to 1.23 kg were seen."""
    program, truth = assembly.program, assembly.values({"sled_mass_kg": MASS})
    memory = program.memory(assembly.start(truth), period_s=PERIOD)
    y, _, bad = program.run(memory, SampledInputs(COMMANDS, PERIOD), truth, stepping=Stepping(1))
    assert bad < 0
    y += 1e-4 * np.random.default_rng(0).standard_normal(y.shape)
    columns = {"time_s": PERIOD * np.arange(len(y))}
    columns |= dict(zip(program.inputs, COMMANDS.T, strict=True))
    read = [(i, name) for i, name in enumerate(program.outputs) if "position" in name]
    columns |= {name: y[:, i] for i, name in read}
    recording = pamid.Recording.from_pandas(pd.DataFrame(columns))
    evidence = split_recordings(assembly.rig, [recording], [])
    fitted = model_with(evidence, (), observed_sizes(evidence))
    tracks = evidence.tracks(fitted)
    found = fit_robustly(Problem(fitted, tracks, free_parameters(fitted, tracks)))
    (at,) = (i for i, b in enumerate(fitted.parameters) if b.key == "sled_mass")
    assert abs(found.p[at] - MASS) < 0.5 * abs(1.0 - MASS)
