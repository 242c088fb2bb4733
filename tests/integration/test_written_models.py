"""A finding written into a model file, judged by plain MuJoCo: the written file does what pamid's
own model of the finding does, and the export states how far off it is."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mechanisms
import numpy as np
import pytest
from pamid_cli import frame

from pamid.base.arrays import Array
from pamid.base.csv_table import table_bytes
from pamid.base.errors import FileError
from pamid.base.run_folder import Run
from pamid.base.schemas import fit_file as result
from pamid.base.schemas.command_files import PlainSettings
from pamid.diagnosis.verdict import diagnosis_run
from pamid.engine.program import Stepping
from pamid.exports.exporting import export_model
from pamid.model.assembly import Assembly
from pamid.model.attachment import attach
from pamid.model.registry import effects, rig_named
from pamid.networks.correction.identified_model import load_identified, simulate_identified
from pamid.rigs.simulators.mujoco_file import open_mujoco
from pamid.rigs.simulators.mujoco_forms import IdentifiedEffect
from pamid.rigs.simulators.mujoco_mechanism import read_mechanism
from pamid.rigs.simulators.plain_mujoco import PlainModel, RecordedStretch
from pamid.rigs.simulators.stepped_mechanism import SteppedMechanism
from pamid.rigs.simulators.write_back import WrittenModel, write_back

mujoco: Any = mechanisms.needs_mujoco()


ARM = """<mujoco model="arm">
  <compiler angle="radian"/>
  <option timestep="0.002"/>
  <worldbody>
    <body name="upper">
      <joint name="a" axis="0 1 0" armature="0.01" damping="0.05"/>
      <inertial pos="0 0 -0.2" mass="1" diaginertia="0.01 0.01 0.001"/>
      <body name="fore" pos="0 0 -0.4">
        <!-- squeaks -->
        <joint name="b" axis="0 1 0" armature="0.005" damping="0.02"/>
        <inertial pos="0 0 -0.15" mass="0.6" diaginertia="0.005 0.005 0.001"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="ma" joint="a"/>
    <position name="mb" joint="b" kp="8" kv="0.4"/>
  </actuator>
  <sensor>
    <jointpos name="qa" joint="a"/>
    <jointpos name="qb" joint="b"/>
  </sensor>
</mujoco>
"""
INPUTS, READINGS = ("ma_command", "mb_command_rad"), ("qa_rad", "qb_rad")
SAMPLES, SHORT = 1000, 500
PERIOD_S = 0.004
WINDOW = 250  # samples
FINE = PlainSettings(timestep_s=0.001, integrator="RK4")
DRY = 'solreffriction="0.0002 1"'  # as hard as a step of 0.1 ms allows


def commands(samples: int = SAMPLES) -> Array:
    """Random steps, held for 0.2 s: a torque (N m) and an angle (rad)."""
    levels = np.random.default_rng(3).uniform(-1.0, 1.0, (samples // 50, 2)) * [2.0, 0.8]
    return np.repeat(levels, 50, axis=0)


def recorded(text: str, samples: int = SAMPLES) -> dict[str, Array]:
    """Columns of a log of an arm that MuJoCo simulates at 0.1 ms, RK4."""
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.timestep, model.opt.integrator = 1e-4, int(mujoco.mjtIntegrator.mjINT_RK4)
    data, u, rows = mujoco.MjData(model), commands(samples), []
    for row in u:
        rows.append(data.qpos.copy())
        data.ctrl[:] = row
        mujoco.mj_step(model, data, round(PERIOD_S / model.opt.timestep))
    y = np.array(rows) + 1e-4 * np.random.default_rng(1).standard_normal(u.shape)
    return {**dict(zip(INPUTS, u.T, strict=True)), **dict(zip(READINGS, y.T, strict=True))}


def written(folder: Path, text: str = ARM, name: str = "arm.xml") -> Path:
    file = folder / name
    file.write_text(text)
    return file


# ---- run folders without the fit: what a diagnosis would have left of known causes ----


def fitted_values(
    rig: Path, labels: Sequence[str], values: Mapping[str, float]
) -> result.FittedModel:
    """The model of a rig with effects at these values, SI by key ("label:name"), the others as the
    file and the data sheets have them."""
    made = rig_named(str(rig))
    assembly = Assembly(made, tuple(attach(made, label, effects()) for label in labels), True)
    p = dict(zip(assembly.keys, assembly.values().tolist(), strict=True))
    assert set(values) <= set(p), sorted(p)
    return result.FittedModel(
        effects=tuple(labels), stepping=result.Steps(substeps=1), values={**p, **values}
    )


def make_run(
    folder: Path,
    rig: Path,
    columns: Mapping[str, Array],
    readings: Sequence[str],
    model: result.FittedModel,
    *,
    rivals: Mapping[str, tuple[float, result.FittedModel]] | None = None,
    noise: float = 1e-4,
    stated: float = 1e-3,
) -> Path:
    """A run whose second half is held out. columns: inputs and readings by column, SI; stated: the
    error of every reading that the run states."""
    run = Run.create(folder, command="diagnose", seed=0, inputs=[rig], options={"rig": str(rig)})
    count = len(next(iter(columns.values())))
    fit: dict[str, Any] = result.FitFile(
        rig=rig_named(str(rig)).name,
        recordings=(result.RecordingUsed(name="log", period_s=PERIOD_S, samples=count),),
        channels=tuple(readings),
        inputs=tuple(c for c in columns if c not in readings),
        noise=dict.fromkeys(readings, noise),
        mae={c: {"refitted": stated} for c in readings},
        model=model,
    ).as_json()
    if model.effects:
        fit["cause"] = fit["model"]
    if rivals:
        fit["rivals"] = {
            k: {"probability": p, "model": m.as_json()} for k, (p, m) in rivals.items()
        }
    # the parts that only a fit could fill are left out
    run.path("fit.json").write_text(json.dumps(fit), encoding="utf-8")
    time, part = PERIOD_S * np.arange(count), (np.arange(count) >= count // 2).astype(float)
    place = np.arange(count) % WINDOW
    window = np.where(place < WINDOW // 10, -1.0, np.arange(count) // WINDOW)
    header = ["time_s", "recording", "part", "window", *columns]
    table = np.column_stack([time, np.zeros(count), part, window, *columns.values()])
    run.path("residual.csv").write_bytes(table_bytes(header, table, ["%.12g"] * len(header)))
    run.finish()
    return folder


# ---- every effect as MuJoCo has it ---------------------------------------------------------------


def errors(
    folder: Path,
    effects: Mapping[str, Mapping[str, float]],
    text: str = ARM,
    settings: PlainSettings = FINE,
) -> tuple[Array, Array, Any]:
    """Mean absolute difference to pamid's model with the effects, of the old file and the new one
    in plain MuJoCo at these settings, (readings,) each; and what was written."""
    file, u = written(folder, text), commands(SHORT)
    nothing = dict.fromkeys(READINGS, np.zeros(SHORT))
    inputs = dict(zip(INPUTS, u.T, strict=True))
    values = {f"{k}:{name}": v for k, own in effects.items() for name, v in own.items()}
    model = fitted_values(file, tuple(effects), values)
    run = make_run(folder / "run", file, {**inputs, **nothing}, READINGS, model)
    identified = replace(load_identified(run, rig=str(file)), stepping=Stepping(4))
    truth = simulate_identified(identified, u)
    made = export_model(identified, "mjcf", folder / "new.xml", anyway=True)
    times, all_scored = PERIOD_S * np.arange(SHORT), np.ones(SHORT, bool)
    stretch = RecordedStretch(times, inputs, {}, nothing, all_scored, 25)
    off = []
    for path in (file, folder / "new.xml"):
        mechanism = read_mechanism(path)
        columns = dict(zip(mechanism.commanded, INPUTS, strict=True))
        mechanism = replace(
            mechanism,
            actuators=tuple(
                replace(a, column=columns.get(i, "")) for i, a in enumerate(mechanism.actuators)
            ),
        )
        plain = PlainModel(open_mujoco(path), mechanism, settings=settings)
        (y,) = plain.simulate(stretch, plain._guess(stretch)[None])
        off.append(np.abs(y - truth).mean(axis=0))
    return off[0], off[1], made


@pytest.mark.parametrize(
    "effects",
    [
        {
            "viscous-friction@a": {"damping": 0.1},
            "quadratic-drag@b": {"drag": 0.05},
            "cubic-stiffness@a": {"hardening": 1.0, "rest": 0.2, "reach": 5.0},
            "linear-stiffness@a": {"stiffness": 1.0, "rest": 0.3},
            "constant-offset@b": {"level": 0.3},
            "cogging@b": {"sine": 0.1, "cosine": 0.05, "period": 0.3},
            "gravity@a": {"sine": 0.3, "cosine": 0.1},
        },
        {
            "lugre-friction@a": {
                "level": 0.2, "breakaway": 1.5, "speed": 0.1, "give": 0.003, "settling": 0.002,
            },
            "dahl-friction@b": {"level": 0.1, "reach": 0.02},
            "asymmetric-saturation@ma_command": {"upper": 0.8, "lower": -1.5, "share": 1.0},
            "offset@mb_command": {"level": 0.1},
        },
        {
            "two-mass@b_transmission": {"share": 1.0, "frequency": 6.0, "damping": 0.05},
            "dead-time@mb_command": {"delay": 0.02},
            "gain-error@mb_command": {"gain": 0.2},
            "gain-error@ma_command": {"gain": 0.2},
        },
    ],
    ids=["polynomials", "bristles", "commands"],
)  # fmt: skip
def test_effects_of_mujoco_are_written_as_mujoco_has_them(effects, tmp_path):
    before, now, made = errors(tmp_path, effects)
    assert now.sum() < 0.02 * before.sum()
    assert not made.notes


#: effect -> what a note says of its form
NEAREST = {
    "yielding-friction@b": "a frictionloss that sets in over its speed",
    "directional-friction@b": "the mean frictionloss of both directions",
    "maxwell-slip-hysteresis@a": "bristle friction (lugre) of its level and reach",
    "bouc-wen-hysteresis@b": "bristle friction (lugre) of its level and reach",
}


@pytest.mark.parametrize(
    ("effects", "share"),
    [
        ({"coulomb-friction@a": {"level": 0.15},
          "yielding-friction@b": {"level": 0.1, "speed": 0.4}}, 0.1),
        ({"stribeck-friction@a": {"level": 0.2, "breakaway": 1.5, "speed": 0.1, "give": 0.003},
          "directional-friction@b": {"forward": 0.05, "backward": 0.1}}, 0.15),
        ({"maxwell-slip-hysteresis@a": {"level": 0.2, "reach": 0.1},
          "bouc-wen-hysteresis@b": {"level": 0.1, "reach": 0.1, "shape": 0.7}}, 0.35),
        ({"end-stop@a": {"stiffness": 60.0, "limit": 0.2, "speed": 3.0}}, 0.2),
        ({"two-mass@b_transmission": {"share": 0.9, "frequency": 6.0, "damping": 0.05}}, 0.4),
        ({"two-mass@a_transmission": {"share": 0.9, "frequency": 4.0, "damping": 0.05}}, 0.6),
        ({"backlash@b_transmission":
          {"share": 1.0, "half_gap": 0.02, "frequency": 12.0, "damping": 0.3}}, 0.1),
        ({"load-side-backlash@b_transmission":
          {"share": 1.0, "half_gap": 0.02, "frequency": 12.0, "damping": 0.3,
           "motor_feedback": 1.0}}, 0.1),
    ],
    ids=["friction", "stribeck", "hysteresis", "end-stop", "last-body", "inner-body", "backlash",
         "encoder-behind"],
)  # fmt: skip
def test_other_effects_are_written_in_their_nearest_form(effects, share, tmp_path):
    before, now, made = errors(tmp_path, effects)
    assert now.sum() < share * before.sum()
    for label in effects:
        told = [note.removeprefix(label) for note in made.notes if note.startswith(label)]
        assert len(told) == (label in NEAREST) and all(NEAREST[label] in note for note in told)


@pytest.mark.parametrize(
    ("integrator", "dynamics"), [("RK4", "filter"), ("implicitfast", "filterexact")]
)
def test_a_lag_is_written_as_the_integrator_of_the_file_follows_it(integrator, dynamics, tmp_path):
    """A step of RK4 follows a filter by itself; the other integrators need an exact one."""
    step = '<option timestep="0.004"'
    text = ARM.replace('<option timestep="0.002"', f'{step} integrator="{integrator}"')
    lags = {f"first-order-lag@{c}": {"time_constant": 0.012} for c in ("ma_command", "mb_command")}
    step_s = 0.004 if integrator == "RK4" else 0.0001
    settings = PlainSettings(timestep_s=step_s, integrator=integrator)
    before, now, _ = errors(tmp_path, lags, text, settings)
    assert f'dyntype="{dynamics}"' in (tmp_path / "new.xml").read_text()
    assert now.sum() < 0.02 * before.sum()


# ---- the command ---------------------------------------------------------------------------------

TWO_FRICTIONS = ARM.replace('"a" axis', f'"a" frictionloss="0.15" {DRY} axis').replace(
    '"b" axis', f'"b" frictionloss="0.08" {DRY} axis'
)


def test_frictions_in_two_joints_are_both_written_and_the_file_is_run(tmp_path, capsys, cli):
    """One is dry, one a hysteresis; at 2 ms Euler is off, and the export states what is not."""
    file, new = written(tmp_path), tmp_path / "new.xml"
    labels = ("coulomb-friction@a", "maxwell-slip-hysteresis@b")
    values = {f"{labels[0]}:level": 0.15, f"{labels[1]}:level": 0.08, f"{labels[1]}:reach": 1e-3}
    model = fitted_values(file, labels, values)
    log = recorded(TWO_FRICTIONS)
    run = make_run(tmp_path / "run", file, log, READINGS, model, stated=1e-3)
    said = cli("export", run, "--rig", file, "--to", "mjcf", "--output", new)
    plain = said["plain_mujoco"]
    assert (plain["timestep_s"], plain["integrator"]) == (0.002, "Euler")
    for channel in plain["channels"].values():
        assert channel["now"] < 0.7 * channel["before"]
        assert channel["now"] > 1.2 * channel["stated"]
    assert plain["reached"] and plain["best"] == {"timestep_s": 0.001, "integrator": "RK4"}
    text = new.read_text()
    assert 'frictionloss="0.15"' in text and "lugre=" in text and "<!-- squeaks -->" in text
    assert frame.run(["export", str(run), "--rig", str(file), "--to", "mjcf", "--output", str(new),
                      "--overwrite"]) == 0  # fmt: skip
    printed = capsys.readouterr().out
    assert "in plain MuJoCo (2 ms, Euler)" in printed
    assert '<option timestep="0.001" integrator="RK4"/>' in printed


def test_readings_weigh_by_the_noise_that_the_run_states(tmp_path, monkeypatch, cli):
    file, weights = written(tmp_path), []

    def errors_of(_, __, noise):
        weights.append(noise)
        return dict.fromkeys(noise, 0.0)

    monkeypatch.setattr(PlainModel, "errors", errors_of)
    model = fitted_values(file, ["coulomb-friction@a"], {"coulomb-friction@a:level": 0.15})
    run = make_run(tmp_path / "run", file, recorded(ARM), READINGS, model, noise=0.02)
    cli("export", run, "--rig", file, "--to", "mjcf", "--output", tmp_path / "new.xml")
    assert weights and all(noise == dict.fromkeys(READINGS, 0.02) for noise in weights)


def test_a_file_that_got_worse_is_not_written(tmp_path, cli):
    file, new = written(tmp_path), tmp_path / "new.xml"
    model = fitted_values(file, ["coulomb-friction@a"], {"coulomb-friction@a:level": 1.5})
    run = make_run(tmp_path / "run", file, recorded(ARM), READINGS, model)
    words = (run, "--rig", file, "--to", "mjcf", "--output", new)
    refused = cli("export", *words, code=3)
    assert refused["code"] == "worse" and "--anyway" in refused["hint"] and not new.exists()
    channels = cli("export", *words, "--anyway")["plain_mujoco"]["channels"]
    assert channels["qa_rad"]["now"] > channels["qa_rad"]["before"] and new.exists()


def test_the_most_probable_rival_is_written_or_the_chosen_one(tmp_path, cli):
    file, new = written(tmp_path), tmp_path / "new.xml"
    dry, drag = "coulomb-friction@a", "viscous-friction@a"
    models = {
        dry: fitted_values(file, [dry], {f"{dry}:level": 0.15}),
        drag: fitted_values(file, [drag], {f"{drag}:damping": 0.1}),
    }
    run = make_run(
        tmp_path / "run", file, recorded(TWO_FRICTIONS), READINGS, models[drag],
        rivals={drag: (0.3, models[drag]), dry: (0.6, models[dry])},
    )  # fmt: skip
    words = (run, "--rig", file, "--to", "mjcf", "--output", new)
    said = cli("export", *words)
    assert said["effects"] == [dry] and 'frictionloss="0.15"' in new.read_text()
    assert said["notes"][0].endswith(f"--choose {drag} writes that effect")
    assert cli("export", *words, "--choose", drag, "--overwrite")["effects"] == [drag]
    assert 'damping="0.15"' in new.read_text() and "frictionloss" not in new.read_text()
    refused = cli("export", *words, "--choose", "coulomb-friction@b", "--overwrite", code=2)
    assert dry in refused["hint"]


def test_an_ambiguous_diagnosis_leaves_a_model_of_every_rival(monkeypatch):
    def model(label):
        return SimpleNamespace(assembly=label, fit=label, replays=())

    def named(label):
        figures = {"removed": 0.9 if label == "one" else 0.2}
        return SimpleNamespace(
            effect=SimpleNamespace(label=label), model=model(label), figures=figures
        )

    monkeypatch.setattr(diagnosis_run, "fit_json", lambda *_: {})
    monkeypatch.setattr(diagnosis_run, "model_json", lambda assembly, _: {"model": assembly})
    monkeypatch.setattr(
        diagnosis_run, "posterior_of", lambda fit: SimpleNamespace(as_json=lambda: fit)
    )
    monkeypatch.setattr(diagnosis_run, "replace", lambda *_, **__: None)
    monkeypatch.setattr(diagnosis_run, "probability", lambda figures: figures["removed"])
    answer = SimpleNamespace(causes=(named("one"), named("other")))
    d: Any = SimpleNamespace(
        budget=SimpleNamespace(model=None), cause=model("one"), answer=answer, seed=0,
        verdict="ambiguous",
    )  # fmt: skip
    assert diagnosis_run.models_json(d)["rivals"] == {
        "one": {"probability": 0.9, "model": {"model": "one", "posterior": "one"}},
        "other": {"probability": 0.2, "model": {"model": "other", "posterior": "other"}},
    }
    d.verdict = "explained"
    assert "rivals" not in diagnosis_run.models_json(d)


def test_ranges_for_randomisation_hold_intervals_and_correlations(tmp_path, cli):
    file, dry = written(tmp_path), "coulomb-friction@a"
    model = fitted_values(file, [dry], {f"{dry}:level": 0.15, "upper_mass": 1.1})
    posterior = result.Posterior(
        keys=("upper_mass", f"{dry}:level"), log=(True, False), centre=(0.0, 0.1),
        spread=(0.2, 0.1), value=(0.5, 0.5), held=(0.0, 0.0), others={},
        covariance=((0.01,), (0.012, 0.04)),
    )  # fmt: skip
    model = model.model_copy(update={"posterior": posterior})
    run = make_run(tmp_path / "run", file, recorded(TWO_FRICTIONS), READINGS, model)
    path, ranges = run / "fit.json", tmp_path / "ranges.yaml"
    fit = json.loads(path.read_text())
    mass = 1.1 * 0.2 * 0.1  # kg, standard deviation of the posterior
    ends = {"low": 1.1 - 2 * 1.959964 * mass, "high": 1.1 + 2 * 1.959964 * mass}
    fit["parameters"] = {"upper_mass_kg": {"value": 1.1, **ends}}
    path.write_text(json.dumps(fit))
    words = ("--to", "mjcf", "--output", tmp_path / "new.xml", "--randomise", ranges)
    said = cli("export", run, "--rig", file, *words)
    assert said["files"] == [str(tmp_path / "new.xml"), str(ranges)]
    lines = ranges.read_text().splitlines()
    assert '  - name: "upper_mass"' in lines and '    attribute: "mass"' in lines
    assert f'    effect: "{dry}"' in lines
    nominal = [float(x.split()[1]) for x in lines if x.startswith("    nominal")]
    assert nominal == pytest.approx([1.1, 0.15])
    deviations = [float(x.split()[1]) for x in lines if x.startswith("    standard_deviation")]
    assert deviations == pytest.approx([2 * mass, 0.1 * 0.2])
    table = np.array([json.loads(x.strip()[2:]) for x in lines[lines.index("covariance:") + 1 :]])
    assert np.sqrt(np.diag(table)) == pytest.approx(deviations)
    assert table[0, 1] / np.prod(deviations) == pytest.approx(0.6)


def test_a_stepped_model_is_written_too(tmp_path, cli):
    """It is in air that drags, so MuJoCo steps it."""
    text = ARM.replace('damping="0.05"', 'damping="0.05" stiffness="0.5 0 1"').replace(
        "<option ", '<option density="1.2" '
    )
    file, new = written(tmp_path, text), tmp_path / "new.xml"
    assert isinstance(rig_named(str(file)), SteppedMechanism)
    truth = text.replace('"a" axis', f'"a" frictionloss="0.15" {DRY} axis')
    labels = ("coulomb-friction@a", "cubic-stiffness@b")
    values = {f"{labels[0]}:level": 0.15, f"{labels[1]}:hardening": 0.0}
    model = fitted_values(file, labels, values)
    run = make_run(tmp_path / "run", file, recorded(truth), READINGS, model, stated=2e-3)
    said = cli("export", run, "--rig", file, "--to", "mjcf", "--output", new)
    channel = said["plain_mujoco"]["channels"]["qa_rad"]
    assert channel["now"] < 0.2 * channel["before"]
    assert 'stiffness="0.5 0 1"' in new.read_text()


# ---- what is in the text -------------------------------------------------------------------------


def test_an_encoder_behind_a_play_needs_a_sensor(tmp_path):
    """Without one MuJoCo's user reads the motor; the loop of a servo holds its motor, too."""
    behind = {"share": 1.0, "half_gap": 0.02, "frequency": 12.0, "damping": 0.3}
    play = {"load-side-backlash": {**behind, "motor_feedback": 0.1}}
    for sensors in (True, False):
        text = ARM if sensors else ARM.replace('    <jointpos name="qb" joint="b"/>\n', "")
        done = with_effects(tmp_path, ("transmission", 1), play, text)
        assert bool(done.left) != sensors
        assert done.notes == ("load-side-backlash is written with the motor's encoder in the loop",)
        assert (b'<tendonpos name="qb" tendon="b_output"' in done.text) == sensors


def test_keyframes_follow_a_second_joint_and_degrees_stay_degrees(tmp_path):
    text = (
        ARM.replace('<compiler angle="radian"/>', "")
        .replace("</sensor>", '</sensor>\n  <keyframe><key qpos="0.1 0.2" qvel="1 2"/></keyframe>')
        .replace('kp="8"', 'kp="8" ctrlrange="-1 1"')
    )
    mechanism = read_mechanism(written(tmp_path, text))
    ports = {(p.kind, p.number): p for p in mechanism.ports}
    behind = {"share": 1.0, "half_gap": 0.02, "frequency": 12.0, "damping": 0.3}
    done = write_back(
        mechanism,
        {p.parameter.name: p.parameter.value for p in mechanism.parameters},
        [IdentifiedEffect("backlash", "backlash", behind, (ports["transmission", 0],)),
         IdentifiedEffect("spring", "linear-stiffness", {"stiffness": 2.0, "rest": 0.3},
                                  (ports["motion", 1],))],
    )  # fmt: skip
    model = done.file.model
    assert model.key_qpos.tolist() == [[0.1, 0.0, 0.2]] and model.key_qvel.tolist() == [[1, 0, 2]]
    assert model.jnt_range[1] == pytest.approx([-0.02, 0.02])
    assert model.qpos_spring[2] == pytest.approx(0.3) and model.jnt_stiffness[2] == 2.0


def with_effects(
    folder: Path,
    place: tuple[str, int],
    effects: Mapping[str, Mapping[str, float]],
    text: str = ARM,
) -> WrittenModel:
    """The arm with effects at its port of this kind and number."""
    mechanism = read_mechanism(written(folder, text))
    (port,) = (p for p in mechanism.ports if (p.kind, p.number) == place)
    values = {p.parameter.name: p.parameter.value for p in mechanism.parameters}
    return write_back(
        mechanism, values, [IdentifiedEffect(k, k, v, (port,)) for k, v in effects.items()]
    )


def test_an_effect_that_mujoco_cannot_hold_is_left_to_a_callback(tmp_path):
    done = with_effects(tmp_path, ("command", 0), {"dead-zone": {"half_width": 0.2}})
    (note,) = done.notes
    assert note.startswith("dead-zone (half_width = 0.2, SI) is not in the file")
    assert "export --to c" in note and "callback" in note
    assert done.text == ARM.encode()


def test_a_late_and_limited_reading_is_a_sensor_with_delay_and_cutoff(tmp_path):
    effects = {"dead-time": {"delay": 0.012}, "saturation": {"limit": 0.2, "share": 1.0}}
    done = with_effects(tmp_path, ("reading", 1), effects)
    model = done.file.model
    assert model.sensor_delay.tolist() == pytest.approx([0.0, 0.012])
    assert model.sensor_cutoff.tolist() == [0.0, 0.2] and not done.notes and not done.left
    data, angles, read = mujoco.MjData(model), [], []
    for row in commands(100):
        angles.append(data.qpos[1])
        data.ctrl[:] = row
        mujoco.mj_step(model, data)
        read.append(data.sensordata[1])
    assert read[6:] == pytest.approx(np.clip(angles[:-6], -0.2, 0.2), abs=1e-12)


def test_unnamed_joints_and_polynomials_are_kept(tmp_path):
    """Two motors at a joint that the file does not name, and a damper with a cubic term."""
    text = (
        ARM.replace('<joint name="b" ', "<joint ")
        .replace('damping="0.02"', 'damping="0.02 0 0.3"')
        .replace('    <position name="mb" joint="b" kp="8" kv="0.4"/>\n', "")
        .replace('    <jointpos name="qb" joint="b"/>\n', "")
    )
    mechanism = read_mechanism(written(tmp_path, text))
    port = next(p for p in mechanism.ports if (p.kind, p.number) == ("motion", 1))
    values = {p.parameter.name: p.parameter.value for p in mechanism.parameters}
    dahl = {"level": 0.2, "reach": 0.02}
    done = write_back(
        mechanism,
        {**values, "joint_1_damping": 0.04},
        [IdentifiedEffect(k, "dahl-friction", dahl, (port,)) for k in ("one", "other")],
    )
    model = done.file.model
    assert model.dof_damping[1] == 0.04 and model.dof_dampingpoly[1].tolist() == [0.0, 0.3]
    assert (model.nu, model.nactuator, model.na) == (1, 3, 2)
    assert model.actuator_trnid[1:, 0].tolist() == [1, 1] and not done.left


def test_a_written_file_with_bristles_is_a_rig_again(tmp_path):
    text = ARM.replace(
        "</actuator>",
        '<dcmotor joint="a" name="dry" input="none" motorconst="0" resistance="1" '
        'lugre="100 0 0.2 0.3 0.1"/></actuator>',
    )
    mechanism = read_mechanism(written(tmp_path, text))
    assert not mechanism.hindrances
    rig = SteppedMechanism(mechanism)
    assert tuple(rig.inputs) == INPUTS and rig.states[-1].name == "dry_bristle"
    p, x = Assembly(rig).values()[None], np.zeros((1, len(rig.states)))
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    for row in commands(100):
        data.ctrl[:] = row
        mujoco.mj_step(model, data)
        x, _ = rig.steps(x, np.array([[*row, 0.0, 0.0]]), p, 0.002, ())
        assert np.abs(x[0] - [*data.qpos, *data.qvel, *data.act]).max() < 1e-9


URDF = """<robot name="lever">
  <link name="base"/>
  <link name="lever">
    <inertial>
      <origin xyz="0 0 -0.2"/><mass value="1.5"/>
      <inertia ixx="0.02" iyy="0.02" izz="0.001" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
  <joint name="pivot" type="continuous">
    <parent link="base"/><child link="lever"/><axis xyz="0 1 0"/>
  </joint>
  <transmission name="drive">
    <joint name="pivot"><hardwareInterface>EffortJointInterface</hardwareInterface></joint>
  </transmission>
</robot>
"""


LEVER_ANGLE = "pivot_position_rad"


def lever_log(model: Any) -> dict[str, Array]:
    """What a lever logs under the first of the commands."""
    model.opt.timestep = 2e-4
    data, rows, torques = mujoco.MjData(model), [], commands()[:, 0]
    for torque in torques:
        rows.append(float(data.qpos[0]))
        data.qfrc_applied[0] = torque
        mujoco.mj_step(model, data, 20)
    return {"pivot_torque_nm": torques, LEVER_ANGLE: np.array(rows)}


def test_urdf_gets_friction_damping_and_inertials(tmp_path, cli):
    file, new = written(tmp_path, URDF, "lever.urdf"), tmp_path / "new.urdf"
    model = mujoco.MjModel.from_xml_path(str(file))
    model.dof_frictionloss[0], model.dof_solref[0, 0], model.dof_damping[0] = 0.2, 4e-4, 0.3
    model.body_mass[1] *= 1.2
    model.body_inertia[1] *= 1.2
    labels = ("coulomb-friction", "viscous-friction")
    values = {f"{labels[0]}:level": 0.2, f"{labels[1]}:damping": 0.3, "lever_mass": 1.8}
    fitted = fitted_values(file, labels, values)
    run = make_run(tmp_path / "run", file, lever_log(model), (LEVER_ANGLE,), fitted)
    words = (run, "--rig", file, "--output", new)
    said = cli("export", *words, "--to", "urdf")
    channel = said["plain_mujoco"]["channels"][LEVER_ANGLE]
    assert channel["now"] < 0.2 * channel["before"]
    text = new.read_text()
    assert '<dynamics damping="0.3" friction="0.2"/>' in text and 'mass value="1.8"' in text
    assert 'ixx="0.024"' in text


def test_a_urdf_becomes_an_mjcf_with_what_a_urdf_cannot_hold(tmp_path, cli):
    file, new = written(tmp_path, URDF, "lever.urdf"), tmp_path / "new.xml"
    model = mujoco.MjModel.from_xml_path(str(file))
    model.dof_armature[0] = 0.05
    fitted = fitted_values(file, (), {"pivot_armature": 0.05})
    run = make_run(tmp_path / "run", file, lever_log(model), (LEVER_ANGLE,), fitted)
    said = cli("export", run, "--rig", file, "--output", new, "--to", "mjcf")
    channel = said["plain_mujoco"]["channels"][LEVER_ANGLE]
    assert channel["now"] < 0.2 * channel["before"]
    assert mujoco.MjModel.from_xml_path(str(new)).dof_armature[0] == pytest.approx(0.05)
    assert sorted(p.suffix for p in tmp_path.iterdir() if p.is_file()) == [".urdf", ".xml"]
    refused = cli(
        "export", run, "--rig", new, "--output", tmp_path / "new.urdf", "--to", "urdf", code=3
    )
    assert refused["code"]


def test_a_rig_of_equations_has_no_model_file(tmp_path):
    rig = rig_named("one-dof")
    assembly = Assembly(rig, (), True)
    model: Any = SimpleNamespace(assembly=assembly, name="one-dof")
    with pytest.raises(FileError, match="does not come from a model file"):
        export_model(model, "mjcf", tmp_path / "a.xml")
