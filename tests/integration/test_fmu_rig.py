"""An FMU as a rig: pamid's own export, held by another process, is the model that it was made
from."""

import os
import shutil
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from foreign_fmus import changed
from pendulums import WrittenPendulum

import pamid
from pamid.base.arrays import Array
from pamid.base.errors import PamidError
from pamid.engine.program import Stepping
from pamid.engine.sampled_inputs import SampledInputs
from pamid.exports.fmu import make_fmu
from pamid.exports.step import step_of
from pamid.model.assembly import Assembly
from pamid.model.attachment import Attachment, attachments
from pamid.model.registry import effects, rig_named
from pamid.model.rig import Rig
from pamid.networks.correction.identified_model import Identified
from pamid.rigs.simulators.fmu_file import FmuFile, read_fmu
from pamid.rigs.simulators.fmu_rig import FmuRig
from pamid.simulation.excitation.aprbs import aprbs

pytest.importorskip("fmpy", reason="the extra [fmu] is not installed")
if not shutil.which("cc") and not shutil.which("gcc"):
    pytest.skip("no C compiler builds the FMU", allow_module_level=True)


PERIOD, SAMPLES = WrittenPendulum.period_s, 120
U = aprbs(SAMPLES * PERIOD, PERIOD, 6.0, (0.1, 0.4), seed=1)[:, None]


def _exported(folder: Path, version: int) -> Path:
    assembly = Assembly(WrittenPendulum())
    model = Identified("pendulum", assembly, assembly.values(), PERIOD, Stepping(1))
    path = folder / f"pendulum{version}.fmu"
    path.write_bytes(make_fmu(step_of(model), version).data)
    return path


@pytest.fixture(scope="module")
def fmu(tmp_path_factory) -> Path:
    return _exported(tmp_path_factory.mktemp("fmu"), 2)


def _run(a: Assembly, parts: int = 1) -> tuple[Array, Array]:
    """Outputs, and their derivatives by the five parameters of the pendulum and those of
    effects."""
    p = a.values()
    memory = a.program.memory(a.start(p), len(p), period_s=PERIOD)
    rows = []
    for at in np.array_split(np.arange(SAMPLES), parts):
        y, by, bad = a.program.run(
            memory,
            SampledInputs(U[at], PERIOD, at[0] * PERIOD),
            p,
            columns=np.arange(len(p), dtype=np.int64),
        )
        assert bad < 0
        rows.append((y, by[:, :, : len(p)]))
    return np.concatenate([y for y, _ in rows]), np.concatenate([by for _, by in rows])


def _effect(rig: Rig, name: str, port: str) -> Attachment:
    return next(a for a in attachments(rig, [effects()[name]]) if a.ports == (port,))


@pytest.mark.parametrize(("version", "saves"), [(2, True), (3, False)])
def test_it_is_the_model_that_was_exported(tmp_path, version, saves):
    rig = FmuRig(replace(read_fmu(_exported(tmp_path, version)), saves=saves))
    assert {q.name for q in rig.parameters} == {q.name for q in WrittenPendulum.parameters}
    y, by = _run(Assembly(rig))
    truth, slopes = _run(Assembly(WrittenPendulum()))
    assert np.abs(y - truth).max() <= 1e-14
    assert np.abs(by - slopes).max() <= 1e-3 * np.abs(slopes).max()
    again, also = _run(Assembly(rig), parts=4)
    assert np.array_equal(again, y) and np.array_equal(also, by)


def test_effects_act_on_what_goes_in_and_what_comes_out(fmu):
    rig = rig_named(str(fmu))
    assert isinstance(rig, FmuRig)
    for name, port, own in (
        ("first-order-lag", "read_angle_rad", "encoder"),
        ("dead-time", "read_position_m", "ruler"),
    ):
        y, by = _run(Assembly(rig, (_effect(rig, name, port),)))
        written = WrittenPendulum()
        truth, slopes = _run(Assembly(written, (_effect(written, name, own),)))
        assert np.abs(y - truth).max() <= 1e-12
        assert np.abs(by - slopes).max() <= 1e-3 * np.abs(slopes).max()


def test_a_force_that_goes_in_is_declared_a_motion_port(fmu):
    class Pushed(FmuRig):
        path = str(fmu)
        motion = {"force_n": ("position_m", "speed_m_per_s")}

    with pytest.raises(PamidError, match="'speed_m_per_s', but the FMU has no such output"):
        Pushed()

    class Driven(FmuRig):
        path = str(fmu)
        motion = {"force_n": ("position_m", "position_m")}

    rig = Driven()
    spring = _effect(rig, "linear-stiffness", "at_force_n")
    a = Assembly(rig, (spring,), sizes={("at_force_n", "value"): 5.0})
    written = WrittenPendulum()
    b = Assembly(
        written, (_effect(written, "linear-stiffness", "rail"),), sizes={("rail", "value"): 5.0}
    )
    y, truth = _run(a)[0], _run(b)[0]
    far = np.abs(truth - _run(Assembly(written))[0]).max()
    assert np.abs(y - truth).max() < 0.1 * far  # the force is held over a sample


def test_it_is_fitted_from_the_start_of_a_recording(fmu):
    u = aprbs(3.0, PERIOD, 6.0, (0.1, 0.6), seed=3)
    sent = pd.DataFrame({"time_s": PERIOD * np.arange(len(u)), "force_n": u})
    recording = pamid.simulate(
        pamid.Recording.from_pandas(sent), WrittenPendulum, parameters={"cart_kg": 1.1}
    )
    found = pamid.fit(recording, fmu, check=False)
    cart = found.parameters["cart_kg"]
    assert cart.low is not None and cart.high is not None
    assert cart.low <= 1.1 <= cart.high and cart.high - cart.low < 0.1


# ---- what is wrong with it -----------------------------------------------------------------------


def _file(fmu: Path) -> FmuFile:
    return read_fmu(fmu)


def test_a_crash_is_a_sentence_and_nothing_else_is_lost(fmu):
    rig = FmuRig(_file(fmu))
    a = Assembly(rig)
    assert np.isfinite(_run(a)[0]).all()
    os.kill(rig._process.child.pid, signal.SIGSEGV)
    with pytest.raises(
        PamidError, match=r"pendulum2.fmu: the FMU failed: it crashed \(signal 11\)"
    ):
        _run(a)
    with pytest.raises(PamidError, match="the FMU failed: it crashed"):
        _run(a)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            lambda name, data: None if name.startswith("binaries") else (name, data),
            "no machine: it holds sources, not for this one.*fmpy compile",
        ),
        (lambda name, data: (name, data[: len(data) // 2]), "cannot be read as an FMU"),
        (
            lambda name, data: (name, data.replace(b"CoSimulation", b"ModelExchange")),
            "without co-simulation|cannot be read as an FMU",
        ),
    ],
)
def test_an_fmu_that_cannot_go_says_why(fmu, tmp_path, change, words):
    with pytest.raises(PamidError, match=words):
        rig_named(str(changed(fmu, tmp_path, change)))


def test_what_is_no_fmu_is_refused(tmp_path):
    (tmp_path / "text.fmu").write_text("no zip")
    with pytest.raises(PamidError, match="cannot be read as an FMU"):
        rig_named(str(tmp_path / "text.fmu"))
    with pytest.raises(PamidError, match="no such file"):
        rig_named(str(tmp_path / "absent.fmu"))


def test_a_recording_cannot_name_one(fmu, tmp_path):
    frame = pd.DataFrame({"time_s": PERIOD * np.arange(SAMPLES), "force_n": U[:, 0]})
    frame["position_m"] = 0.0
    path = tmp_path / "rec.csv"
    frame.to_csv(path, index=False)
    path.with_suffix(".toml").write_text(f'[recording]\nrig = "{fmu}"\n')
    with pytest.raises(PamidError, match="is code, run only when you name it yourself"):
        pamid.fit(path)
