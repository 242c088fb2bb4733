"""A MuJoCo model with contacts, stepped by MuJoCo as a rig, against MuJoCo by itself."""

import ctypes
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import pamid
from pamid.base.arrays import Array
from pamid.base.errors import PamidError
from pamid.engine.program import Stepping
from pamid.engine.sampled_inputs import SampledInputs
from pamid.engine.stepped import SteppedProgram
from pamid.estimation.grey_box import model_with
from pamid.estimation.observed_sizes import observed_sizes
from pamid.estimation.problem import Problem, free_parameters
from pamid.estimation.restart import fit_from_shorter_windows
from pamid.estimation.robust_fit import fit_robustly
from pamid.intake.checks.conformance import NULL_TOLERANCE, null_error
from pamid.model.assembly import Assembly
from pamid.model.attachment import attachments
from pamid.model.registry import effects, rig_named
from pamid.rigs.simulators.stepped_mechanism import SOLVER_TOLERANCE, SteppedMechanism
from pamid.simulation.data_split import split_recordings
from pamid.simulation.excitation.aprbs import aprbs
from pamid.simulation.free_runs import choose_stepping

mujoco = pytest.importorskip("mujoco", reason="the extra [mujoco] is not installed")


LEG = """<mujoco model="leg">
  <compiler angle="radian"/>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 0.1"/>
    <body name="thigh" pos="0 0 0.52">
      <joint name="hip" axis="0 1 0" damping="0.2" frictionloss="0.05" armature="0.01"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.25" size="0.02" mass="{thigh}"/>
      <body name="shank" pos="0 0 -0.25">
        <joint name="knee" axis="0 1 0" damping="{damping}" range="-2 0.1" limited="true"/>
        <geom name="foot" type="capsule" fromto="0 0 0 0 0 -0.28" size="0.02" mass="0.6"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="push" joint="hip" gear="5" ctrllimited="true" ctrlrange="-1 1"/>
    <position name="servo" joint="knee" kp="{kp}" kv="0.3"/>
  </actuator>
</mujoco>
"""
PERIOD, SAMPLES = 0.004, 500
COMMANDS = np.stack(
    [
        aprbs(SAMPLES * PERIOD, PERIOD, 1.0, (0.1, 0.5), seed=1),
        aprbs(SAMPLES * PERIOD, PERIOD, 0.6, (0.1, 0.5), seed=2) - 0.6,
    ],
    axis=1,
)


def _written(folder: Path, thigh: float = 1.0, damping: float = 0.1, kp: float = 8.0) -> Path:
    path = folder / "leg.xml"
    path.write_text(LEG.format(thigh=thigh, damping=damping, kp=kp))
    return path


def _by_itself(path: Path, torque: Any = None) -> tuple[Array, int]:
    """Positions, then velocities; and in how many steps something touched."""
    model = mujoco.MjModel.from_xml_path(str(path))
    # the rig's solver begins cold, and goes on for longer, so that one state leads to one other
    model.opt.tolerance = SOLVER_TOLERANCE
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_WARMSTART)
    data, rows, touching = mujoco.MjData(model), [], 0
    for command in COMMANDS:
        rows.append(np.concatenate([data.qpos, data.qvel]))
        data.ctrl[:] = command
        data.qfrc_applied[0] = 0.0 if torque is None else torque(data)
        for _ in range(2):
            mujoco.mj_step(model, data)
            touching += data.ncon > 0
    return np.array(rows), touching


def _run(a: Assembly, p: Array) -> Array:
    memory = a.program.memory(a.start(p), period_s=PERIOD)
    y, _, bad = a.program.run(memory, SampledInputs(COMMANDS, PERIOD), p, stepping=Stepping(1))
    assert bad < 0
    order = [a.program.outputs.index(n) for n in NAMES]
    return y[:, order]


NAMES = (
    "hip_position_rad",
    "knee_position_rad",
    "hip_velocity_rad_per_s",
    "knee_velocity_rad_per_s",
)


def test_contacts_are_stepped_as_mujoco_steps_them(tmp_path):
    path = _written(tmp_path)
    rig = rig_named(str(path))
    assert isinstance(rig, SteppedMechanism)
    assert any("stepped by MuJoCo" in text and "geoms touch" in text for text in rig.remarks)
    assert not any("not enforced" in text for text in rig.remarks)  # MuJoCo does
    truth, touching = _by_itself(path)
    assert touching > SAMPLES / 10
    a = Assembly(rig)
    assert np.abs(_run(a, a.values()) - truth).max() < 1e-10


def test_its_library_is_called_as_its_python_package_is(tmp_path, monkeypatch):
    rig = rig_named(str(_written(tmp_path)))
    found = {a.label: a for a in attachments(rig, [effects()["lugre-friction"]])}
    a = Assembly(rig, (found["lugre-friction@hip"],))
    p = a.values()
    k, n = len(p), len(rig.states)
    runs = []
    for whole in (True, False):
        if not whole:
            monkeypatch.setattr(a.rig._stepper, "mj_step", 0)  # type: ignore[attr-defined]
        assert bool(a.rig._stepper.mj_step) is whole  # type: ignore[attr-defined]
        memory = a.program.memory(a.start(p), k + n, stepping=Stepping(2), period_s=PERIOD)
        memory.S[:n, k : k + n] = np.eye(n)
        y, by, bad = a.program.run(
            memory,
            SampledInputs(COMMANDS, PERIOD),
            p,
            stepping=Stepping(2),
            columns=np.arange(k, dtype=np.int64),
            weights=np.arange(1.0, 5.0),
        )
        assert bad < 0
        runs.append((y, by, memory.x, memory.S))
    # contacts part what rounding leaves between two ways of adding up slopes
    for one, other in zip(*runs, strict=True):
        assert np.abs(one - other).max() <= 1e-6 * np.abs(one).max()
    assert np.array_equal(runs[0][0], runs[1][0])


def test_slopes_are_kept_in_its_library_as_in_python(tmp_path, monkeypatch):
    """Where nothing has moved all of them hold; where masses have, contacts are worked out anew;
    where all have moved by more, slopes are probed."""
    rig = rig_named(str(_written(tmp_path)))
    a = Assembly(rig)
    program, sheet = a.program, a.values()
    assert isinstance(program, SteppedProgram)
    k, n = len(sheet), len(rig.states)
    columns, step = np.arange(k, dtype=np.int64), Stepping(2)
    runs, counts = [], []
    for whole in (True, False):
        if not whole:
            monkeypatch.setattr(a.rig._stepper, "mj_step", 0)  # type: ignore[attr-defined]
        known = program.room(SAMPLES, 2, columns)
        assert known is not None
        for share in (0.0, 0.0, 0.02, 0.2):
            p = (1.0 + share) * sheet
            memory = program.memory(a.start(p), k + n, stepping=step, period_s=PERIOD)
            memory.S[:n, k : k + n] = np.eye(n)
            keeping = replace(program, known=known)
            *found, bad = keeping.run(
                memory, SampledInputs(COMMANDS, PERIOD), p, stepping=step, columns=columns
            )
            assert bad < 0
            runs.append(found)
            counts.append(known.counts.tolist())
    exchanges = 2 * SAMPLES
    in_c, in_python = counts[:4], counts[4:]
    assert in_c[:2] == in_python[:2] == [[exchanges, 0, 0], [exchanges, exchanges, exchanges]]
    anew = np.diff([[c[0] for c in one[1:]] for one in (in_c, in_python)])
    assert (anew[0] > 0).all() and (anew[0] < [exchanges / 2, 0.9 * exchanges]).all()
    # one at the edge of a rule may fall beyond
    assert (np.abs(anew[1] - anew[0]) <= [0.01 * exchanges, 0.03 * exchanges]).all()
    for (y, by), (same, also) in zip(runs[:2], runs[4:6], strict=True):
        assert np.array_equal(y, same)
        assert np.abs(by - also).max() <= 1e-6 * np.abs(by).max()


def test_no_clock_is_read_while_its_library_steps(tmp_path):
    stepper: Any = rig_named(str(_written(tmp_path)))._stepper  # type: ignore[attr-defined]
    clock = ctypes.c_void_p.in_dll(stepper.library, "mjcb_time")
    before = clock.value
    assert before  # MuJoCo's Python package has set one
    p = Assembly(rig_named(str(_written(tmp_path)))).values()[None]
    with pytest.raises(ZeroDivisionError), stepper.in_c(p, PERIOD) as library:
        assert library is not None and clock.value is None
        raise ZeroDivisionError
    assert clock.value == before


def test_parameters_are_those_of_the_file(tmp_path):
    a = Assembly(rig_named(str(_written(tmp_path))))
    p = a.values({"thigh_mass_kg": 1.3, "knee_damping_n_m_s_per_rad": 0.2, "servo_kp": 6.0})
    (tmp_path / "other").mkdir()
    other = _written(tmp_path / "other", thigh=1.3, damping=0.2, kp=6.0)
    assert np.abs(_run(a, p) - _by_itself(other)[0]).max() < 1e-9


def test_an_effect_at_a_joint_acts_as_a_torque_there(tmp_path):
    path = _written(tmp_path)
    rig = rig_named(str(path))
    (spring,) = (
        one for one in attachments(rig, [effects()["linear-stiffness"]]) if one.ports == ("hip",)
    )
    assert null_error(rig, spring, draws=1) <= NULL_TOLERANCE
    a = Assembly(rig, (spring,))
    p = a.values()
    keys = {b.key.rpartition(":")[2]: i for i, b in enumerate(a.parameters) if b.owner}
    for i in keys.values():
        p[i] = 0.0
    p[keys["stiffness"]] = 3.0
    truth, _ = _by_itself(path, lambda data: -3.0 * float(data.qpos[0]))
    found = _run(a, p)
    assert np.abs(found - truth).max() < 1e-9
    assert (
        np.abs(found - _run(a, np.where(np.arange(len(p)) == keys["stiffness"], 0.0, p))).max()
        > 0.1
    )


def _recorded(folder: Path, seed: int = 0) -> pamid.Recording:
    """Of a leg with a friction of 0.8 N m at the hip that the file lacks; its thigh weighs 1.15 kg,
    not 1."""
    model = mujoco.MjModel.from_xml_path(str(_written(folder, thigh=1.15, damping=0.12)))
    model.dof_frictionloss[0] += 0.8
    data, samples, random = mujoco.MjData(model), 3000, np.random.default_rng(seed)
    seconds = samples * PERIOD
    sent = np.stack(
        [
            aprbs(seconds, PERIOD, 1.0, (0.1, 0.5), seed=10 * seed + 3),
            aprbs(seconds, PERIOD, 0.6, (0.1, 0.5), seed=10 * seed + 4) - 0.6,
        ],
        axis=1,
    )
    read = np.empty((samples, 2))
    for k, command in enumerate(sent):
        read[k], data.ctrl[:] = data.qpos, command
        for _ in range(2):
            mujoco.mj_step(model, data)
    read += 1e-3 * random.standard_normal(read.shape)
    columns = {"time_s": PERIOD * np.arange(samples), "push_command": sent[:, 0]}
    columns |= {"servo_command_rad": sent[:, 1]}
    columns |= {name: read[:, i] for i, name in enumerate(NAMES[:2])}
    return pamid.Recording.from_pandas(pd.DataFrame(columns))


@pytest.mark.slow
def test_a_fit_that_impacts_trap_begins_with_shorter_windows(tmp_path):
    rig = rig_named(str(_written(tmp_path)))
    evidence = split_recordings(rig, [_recorded(tmp_path, seed=2)], [])
    assembly = model_with(evidence, (), observed_sizes(evidence))
    tracks = evidence.tracks(assembly)
    problem = Problem(assembly, tracks, free_parameters(assembly, tracks))
    trapped = fit_robustly(problem)
    found = fit_from_shorter_windows(trapped)
    thigh = assembly.index_of("thigh_mass_kg")
    assert abs(trapped.p[thigh] - 1.15) > 0.1
    assert abs(found.p[thigh] - 1.15) < 0.05
    left = [np.sqrt((f.residuals[0] ** 2).mean(axis=0)) for f in (trapped, found)]
    assert (left[1] < 0.5 * left[0]).all()
    assert fit_from_shorter_windows(found) is found  # nothing is gained by doing it again


@pytest.mark.slow
def test_friction_planted_in_mujoco_is_found_in_a_model_with_contacts(tmp_path):
    recording = _recorded(tmp_path)
    (tmp_path / "given").mkdir()
    tried = ("coulomb-friction", "viscous-friction", "cubic-stiffness", "gain-error", "dead-time")
    found = pamid.diagnose(
        recording,
        _written(tmp_path / "given"),
        without=[name for name in effects() if name not in tried],
        jobs=1,
    )
    print(found)
    assert [c.effect for c in found.causes] == ["coulomb-friction@hip"]


def test_impacts_inside_ask_for_no_finer_exchange():
    """MuJoCo's own step takes care of them; a shorter one would be another simulation."""
    gymnasium = pytest.importorskip("gymnasium", reason="its hopper falls to the floor")
    assets = Path(gymnasium.__file__).parent / "envs" / "mujoco" / "assets"
    a = Assembly(rig_named(str(assets / "hopper.xml")))
    p, period = a.values(), 0.008
    u = np.stack([aprbs(8.0, period, 0.15, (0.2, 0.8), seed=3 + i) for i in range(3)], axis=1)
    assert choose_stepping(a, u, p, period, a.start(p)) == Stepping(1)


def test_what_becomes_unstable_is_seen_and_not_begun_anew(here, capfd):
    a = Assembly(rig_named(str(_written(here))))
    p = a.values()
    p[a.keys["knee_damping"]] = -50.0
    memory = a.program.memory(a.start(p), period_s=PERIOD)
    y, _, bad = a.program.run(memory, SampledInputs(COMMANDS, PERIOD), p)
    assert 0 <= bad < SAMPLES - 1
    assert np.isnan(y[bad + 1 :]).all()
    assert "unstable" not in "".join(capfd.readouterr())
    assert not (here / "MUJOCO_LOG.TXT").exists()


def test_a_quaternion_joint_is_refused_by_name(tmp_path):
    path = tmp_path / "free.xml"
    path.write_text(
        '<mujoco><worldbody><body><joint name="loose" type="ball"/><geom size="0.1" mass="1"/>'
        '<body pos="1 0 0"><joint name="arm"/><geom size="0.1" mass="1"/></body></body>'
        '</worldbody><actuator><motor joint="arm"/></actuator></mujoco>'
    )
    with pytest.raises(PamidError, match="joint 'loose'.* is a ball joint, whose quaternion"):
        rig_named(str(path))
