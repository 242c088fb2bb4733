"""The model of a run: rebuilt to the last bit, with networks and causes, never by running what the
folder holds."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from identified_runs import SEEN, fitted_run, joint_recording, put_network, random_network
from pamid_cli import frame

from pamid.base.errors import FileError, UsageError
from pamid.base.json_file import write_json
from pamid.base.units import from_si, split_column
from pamid.diagnosis.verdict.diagnosis_run import models_json
from pamid.estimation.grey_box import GreyBox
from pamid.estimation.quantities import reported_values
from pamid.model.registry import rig_named
from pamid.networks.correction.identified_model import (
    Identified,
    load_identified,
    simulate_identified,
)
from pamid.networks.correction.port_network import entered, entry_of
from pamid.networks.elman import Elman
from pamid.recording.recording import Recording, read_recording, write_recording
from pamid.simulation.free_runs import free_run

Made = tuple[Path, Recording, GreyBox]
Copy = Callable[[], Path]
EFFECTS = ("coulomb-friction", "leak@pressure_2")
OUTPUTS = ("angle_deg", "pressure_1_kpa", "pressure_2_kpa", "force_1_n", "force_2_n")


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Made:
    """A recording of a joint with dry friction, and a run with effects at a port and at one place
    of another."""
    folder = tmp_path_factory.mktemp("joint")
    recording = joint_recording(folder)
    return folder / "run", recording, fitted_run(folder / "run", recording.path, EFFECTS)


@pytest.fixture
def run(made, tmp_path) -> Copy:
    """Fresh copies of that run."""
    numbers = iter(range(100))
    return lambda: Path(shutil.copytree(made[0], tmp_path / f"run{next(numbers)}"))


def commands_of(recording: Recording) -> np.ndarray:
    """The joint's inputs, SI."""
    return np.stack([recording.si("command"), np.zeros(len(recording))], axis=1)


def columns(model: Identified, Y: np.ndarray) -> dict[str, np.ndarray]:
    return {
        n: np.asarray(from_si(Y[:, i], split_column(n)[1])) for i, n in enumerate(model.outputs)
    }


def seen_by(
    trained: Any, recording: Recording, outputs: dict[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """A network's inputs from the recording and a model's outputs."""
    return {
        n: recording.signal(n) if recording.has(n) else outputs[n.replace("_refitted", "")]
        for n in trained.input_names
    }


def test_the_model_is_the_fitted_one(made):
    folder, recording, fitted = made
    model = load_identified(folder)
    assert list(model.assembly.keys) == list(fitted.assembly.keys)
    np.testing.assert_array_equal(model.values, reported_values(fitted.fit))
    assert any(
        b.nuisance and v != 0.0
        for b, v in zip(model.assembly.parameters, model.values, strict=True)
    )
    assert (model.stepping, model.period_s, model.outputs) == (fitted.fit.stepping, 0.003, OUTPUTS)
    assert [a.label for a in model.effects] == list(EFFECTS)
    # as the recording states it
    assert model.values[model.assembly.index_of("inertia_kg_m2")] == 0.0896
    u = commands_of(recording)
    Y = simulate_identified(model, u)
    again = free_run(
        fitted.assembly, u, reported_values(fitted.fit), 0.003, stepping=fitted.fit.stepping
    )
    seen = [model.outputs.index(c) for c in fitted.evidence.channels]
    np.testing.assert_allclose(
        Y[:, seen], again.outputs, rtol=0.0, atol=1e-12 * np.ptp(again.outputs, axis=0).max()
    )
    assert np.abs(columns(model, Y)["angle_deg"] - recording.signal("angle_deg")).mean() < 0.1


def test_the_cause_of_a_diagnosis(made, tmp_path):
    """`pamid diagnose` leaves its cause beside the refitted model; the cause is what the run has
    found."""
    _, recording, fitted = made
    plain = fitted_run(tmp_path / "plain", recording.path)
    cause = SimpleNamespace(assembly=fitted.assembly, fit=fitted.fit, replays=fitted.held_out)
    found: Any = SimpleNamespace(
        budget=SimpleNamespace(model=plain), cause=cause, seed=0, answer=None
    )
    write_json(tmp_path / "plain" / "fit.json", models_json(found))
    best, refitted = (load_identified(tmp_path / "plain", which=w) for w in ("best", "refitted"))
    np.testing.assert_array_equal(best.values, reported_values(fitted.fit))
    np.testing.assert_array_equal(refitted.values, reported_values(plain.fit))
    assert not refitted.effects
    with pytest.raises(FileError, match="has no cause"):
        load_identified(made[0], which="cause")
    with pytest.raises(FileError, match="has no network"):
        load_identified(made[0], which="network")
    with pytest.raises(UsageError, match="--which 'worst'"):
        load_identified(made[0], which="worst")


@pytest.mark.parametrize("port", ["joint", "muscle_1", "command"])
def test_a_network_at_a_port(made, run, port):
    """It sees what the uncorrected model puts out, and enters where it was trained, in its unit,
    held over a sample."""
    folder, (_, recording, fitted) = run(), made
    size, unit = {"joint": (1.0, "_nm"), "muscle_1": (30.0, "_n"), "command": (0.1, "")}[port]
    trained = random_network(Elman(3, 4), SEEN, f"missing{unit}", size)
    bent = fitted.fit.p.copy()
    bent[fitted.assembly.index_of("viscous_n_m_s")] *= 2.0
    put_network(
        folder,
        trained,
        enters={"port": port},
        parameters={"viscous_n_m_s": float(bent[fitted.assembly.index_of("viscous_n_m_s")])},
    )
    model, alone = load_identified(folder), load_identified(folder, which="refitted")
    u = commands_of(recording)
    Y, before = simulate_identified(model, u), simulate_identified(alone, u)
    value = trained.predict(seen_by(trained, recording, columns(alone, before)))
    corrected = entered(fitted.assembly, entry_of(rig_named("one-dof"), port))
    p = bent.copy()
    p[corrected.index_of("inertia_kg_m2")] = 0.0896
    expected = free_run(
        corrected, np.column_stack([u, value]), p, 0.003, stepping=model.stepping
    ).outputs
    seen = [model.outputs.index(c) for c in fitted.evidence.channels]
    assert np.abs(Y - before).max() > 1.0
    np.testing.assert_allclose(
        Y[:, seen], expected, rtol=0.0, atol=1e-10 * np.ptp(expected, axis=0).max()
    )
    assert model.inputs == alone.inputs == ("command", "external_torque_nm")


# ---- the command --------------------


def simulate(folder: Path, excitation: Path, output: Path, *more: str) -> int:
    words = f"simulate --model {folder} --excitation {excitation} --output {output} --json"
    return frame.run([*words.split(), *more])


def test_the_command_replays_and_closes_the_loop(made, tmp_path, capsys):
    folder, recording, _ = made
    model, out = load_identified(folder), tmp_path / "out.csv"
    assert simulate(folder, recording.path, out, "--noise", "none") == 0
    said = json.loads(capsys.readouterr().out)
    assert (said["loop"], said["rig"], said["effects"]) == ("open", "one-dof", list(EFFECTS))
    replayed = read_recording(out)
    for name, values in columns(model, simulate_identified(model, commands_of(recording))).items():
        np.testing.assert_allclose(replayed.signal(name), values, rtol=1e-11, atol=1e-11)
    assert replayed.known == {"inertia_kg_m2": 0.0896}
    reference = tmp_path / "reference.csv"
    write_recording(reference, recording.time, {"reference_deg": recording.signal("reference_deg")})
    assert simulate(folder, reference, tmp_path / "loop.csv", "--noise", "none") == 0
    looped = read_recording(tmp_path / "loop.csv")
    assert looped.loop == "closed" and looped.controller == recording.controller
    assert np.abs(looped.signal("angle_deg") - recording.signal("angle_deg")).mean() < 0.5
    assert simulate(folder, reference, tmp_path / "noisy.csv", "--seed", "1") == 0
    assert (
        0.03
        < np.diff(read_recording(tmp_path / "noisy.csv").signal("angle_deg"), 4).std() / np.sqrt(70)
        < 0.07
    )


# ---- folders that are not as they should be --------------------


@pytest.mark.parametrize(
    ("about", "words"),
    [
        ({"enters": {"port": "elbow"}, "parameters": {}}, "no such port"),
        ({"enters": {"port": "joint"}}, "parameters"),
        ({"enters": {"port": "joint"}, "parameters": {"raduis_m": 1.0}}, "no parameter"),
        ({"enters": {}}, "'port'"),
        ({"inputs": 3}, "describe a network"),
        ({"kind": "os"}, "unknown kind"),
        ({"enters": {"port": "joint"}, "parameters": [1]}, "AttributeError"),
    ],
)
def test_a_damaged_network(run, about, words):
    folder = run()
    put_network(folder, random_network(Elman(3, 2), SEEN, "angle_deg", 1.0), **about)
    with pytest.raises(FileError, match=words) as told:
        load_identified(folder)
    assert "network.json" in str(told.value) or "no parameter" in str(told.value)


# ---- rigs and effects that are files --------------------

DAMPED = '''
from pathlib import Path
Path(__file__).with_suffix(".ran").touch()
from pamid import Effect, Parameter

class Stiction(Effect):
    """A drag that grows with the speed."""
    name, family, kinds = "my-drag", "drag", ("motion",)
    signals = ("velocity",)
    parameters = (Parameter("drag", 0.0, low=0.0, high=5.0, unit="N s/m", null=0.0, spread=1.0),)

    def act(self, value, at, p, z):
        return value - p.drag * at.velocity
'''


def test_code_is_run_only_where_it_is_named_again(tmp_path):
    rig, effect, ran = tmp_path / "cart.py", tmp_path / "drag.py", tmp_path / "drag.ran"
    shutil.copy(Path(__file__).parents[2] / "data" / "rigs" / "cart.py", rig)
    effect.write_text(DAMPED, encoding="utf-8")
    time = np.arange(3000) * 0.003
    write_recording(
        tmp_path / "push.csv", time, {"force_n": np.sin(3.0 * time) + np.sign(np.sin(0.9 * time))}
    )
    common = ["--rig", str(rig), "--effect", str(effect), "--json"]
    machine = f"--noise none --rig {rig} --effect {effect}:drag_n_s_per_m=0.7"
    files = f"--excitation {tmp_path}/push.csv --output {tmp_path}/cart.csv"
    assert frame.run(f"simulate {machine} {files}".split()) == 0
    assert (
        frame.run(["fit", str(tmp_path / "cart.csv"), "--output", str(tmp_path / "run"), *common])
        == 0
    )
    ran.unlink()
    with pytest.raises(FileError, match=r"rig file .*add --rig"):
        load_identified(tmp_path / "run")
    with pytest.raises(FileError, match=r"effect file .*add --effect"):
        load_identified(tmp_path / "run", rig=str(rig))
    assert not ran.exists()
    model = load_identified(tmp_path / "run", rig=str(rig), effects=(str(effect),))
    assert model.constants["my-drag:drag"] == pytest.approx(0.7, rel=0.02)
    assert (
        simulate(tmp_path / "run", tmp_path / "push.csv", tmp_path / "out.csv", *common[:-1]) == 0
    )
    ran.unlink()
    effect.write_text(DAMPED + "\n", encoding="utf-8")
    with pytest.raises(FileError, match="SHA-256 differs"):
        load_identified(tmp_path / "run", rig=str(rig), effects=(str(effect),))
    assert not ran.exists()
    rig.write_text(rig.read_text(encoding="utf-8") + "\n", encoding="utf-8")
    with pytest.raises(FileError, match=r"cart\.py that the run was made with"):
        load_identified(tmp_path / "run", rig=str(rig), effects=(str(effect),))
