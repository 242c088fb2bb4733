"""Damaged recordings, settings and run folders: always an answer, never a traceback, a hang, a half-written file, or
code that runs."""

from __future__ import annotations

import io
import json
import os
import pickle
import shutil
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fuzzing import answer, as_json, broken_bytes, broken_json, leftovers
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from identified_runs import SEEN, fitted_run, put_network, random_network
from synthetic_run import make_run, make_trial
from virtual_joint import record

from pamid.networks.elman import Elman

FUZZ = settings(max_examples=int(os.environ.get("PAMID_FUZZ", "8")), deadline=None, derandomize=True,
                suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow,
                                       HealthCheck.data_too_large])  # fmt: skip
#: absurd numbers may well draw a warning from a plot; only faults are looked for
pytestmark = [pytest.mark.filterwarnings("ignore::UserWarning", "ignore::RuntimeWarning"),
              pytest.mark.usefixtures("unchecked")]
KEEP = ("report.html", "figures")


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two seconds of a joint: quick to read, too short to fit."""
    path = record(tmp_path_factory.mktemp("good") / "rec.csv", 6.0).path
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[:120]))
    return path


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_run(tmp_path_factory.mktemp("whole") / "run")


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that was really fitted, with a network behind it: what `simulate --model` and `export` read."""
    place = tmp_path_factory.mktemp("fitted")
    folder = place / "run"
    fitted_run(folder, record(place / "rec.csv", 6.0).path)
    put_network(folder, random_network(Elman(len(SEEN), 2), SEEN, "angle_deg", 1.0))
    return folder


@FUZZ
@given(data=st.data())
def test_a_model(data: st.DataObject, fitted: Path, good: Path, tmp_path: Path,
                 capsys: pytest.CaptureFixture[str]) -> None:
    """fit.json and network.json of a model that is to be simulated and exported."""
    folder = _copied(fitted, tmp_path)
    name = data.draw(st.sampled_from(["run", "fit", "network"])) + ".json"
    content = json.loads((folder / name).read_text())
    (folder / name).write_text(as_json(data.draw(broken_json(content))))
    shutil.rmtree(tmp_path / "out", ignore_errors=True)
    (tmp_path / "out").mkdir()
    answer(capsys, "simulate", "--model", folder, "--excitation", good, "--noise", "none", "--output",
           tmp_path / "out" / "x.csv")
    form = data.draw(st.sampled_from(["c", "matlab", "onnx"]))
    said = answer(capsys, "export", folder, "--to", form, "--output", tmp_path / "out" / "model")
    if said["schema"] == "pamid.error/1":
        assert not list((tmp_path / "out").glob("model*")), "half an export was left behind"
    assert not leftovers(tmp_path)


LOG = "t [ms];Winkel [°];p1 [bar];u\r\n" + "".join(
    f"{3 * k},{k % 7};{np.sin(k / 20):.3f};{1 + np.cos(k / 30):.4f};{(k // 40) % 3 - 1}\r\n".replace(".", ",")
    for k in range(200))
MAPPING = """rig = "one-dof"
loop = "open"
[time]
source = "t"
unit = "ms"
period_s = 0.003
max_gap_s = 0.05
repair = "late-stamps"
[signals.angle_deg]
source = "Winkel"
unit = "deg"
sign = -1
[signals.pressure_1_kpa]
source = "p1"
unit = "bar"
pressure = "absolute"
[signals.command]
source = "u"
unit = "1"
[atmosphere]
pressure_kpa = 100.0
[known]
inertia_kg_m2 = 0.0896
"""


@FUZZ
@given(data=st.data())
def test_raw_logs(data: st.DataObject, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "log.csv").write_bytes(data.draw(broken_bytes(LOG.encode("cp1252"))))
    (tmp_path / "map.toml").write_text(MAPPING)
    answer(capsys, "ingest", "--guess", tmp_path / "log.csv")
    _ingested(tmp_path, capsys)


@FUZZ
@given(data=st.data())
def test_mappings(data: st.DataObject, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "log.csv").write_bytes(LOG.encode("cp1252"))
    (tmp_path / "map.toml").write_bytes(data.draw(broken_bytes(MAPPING.encode())))
    _ingested(tmp_path, capsys)


def _ingested(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """All outputs or none; what was written can be checked."""
    shutil.rmtree(place / "out", ignore_errors=True)
    (place / "out").mkdir()
    said = answer(capsys, "ingest", place / "log.csv", "--mapping", place / "map.toml", "--output", place / "out/r.csv")
    made = sorted((place / "out").rglob("*"))
    assert bool(made) == (said["schema"] == "pamid.ingest/1"), made
    for path in made:
        if path.suffix == ".csv":
            answer(capsys, "check", path)


@FUZZ
@given(data=st.data())
def test_recordings(data: st.DataObject, good: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, output = tmp_path / "rec.csv", tmp_path / "run"
    path.write_bytes(data.draw(broken_bytes(good.read_bytes())))
    path.with_suffix(".toml").write_text(good.with_suffix(".toml").read_text())
    said = answer(capsys, "check", path)
    if said["schema"] == "pamid.error/1" or not said["ok"]:
        assert answer(capsys, "fit", path, "--output", output)["schema"] == "pamid.error/1"
        assert not output.exists()
    shutil.rmtree(output, ignore_errors=True)
    assert not leftovers(tmp_path)


@FUZZ
@given(data=st.data())
def test_the_toml_of_a_recording(data: st.DataObject, good: Path, tmp_path: Path,
                                 capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "rec.csv"
    path.write_bytes(good.read_bytes())
    path.with_suffix(".toml").write_bytes(data.draw(broken_bytes(good.with_suffix(".toml").read_bytes())))
    answer(capsys, "check", path)
    answer(capsys, "simulate", "--excitation", path, "--rig", "one-dof", "--output", tmp_path / "out.csv")
    assert not leftovers(tmp_path)


@FUZZ
@given(data=st.data())
def test_settings(data: st.DataObject, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                  capsys: pytest.CaptureFixture[str]) -> None:
    text = b'[defaults]\nseed = 1\njobs = 2\n[diagnose]\nwithout = ["clock-skew"]\nrig = "one-dof"\n[fit]\nseed = 3\n'
    (tmp_path / "pamid.toml").write_bytes(data.draw(broken_bytes(text)))
    monkeypatch.chdir(tmp_path)
    answer(capsys, "config")
    answer(capsys, "fit", "rec.csv", "--output", "run")
    assert not (tmp_path / "run").exists()


@FUZZ
@given(data=st.data())
def test_json_of_a_run(data: st.DataObject, whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = _copied(whole, tmp_path)
    name = data.draw(st.sampled_from(["run", "fit", "diagnosis", "network"])) + ".json"
    content = json.loads((folder / name).read_text())
    (folder / name).write_text(as_json(data.draw(broken_json(content))))
    _all_readers(folder, tmp_path, capsys)


@FUZZ
@given(data=st.data())
def test_bytes_of_a_run(data: st.DataObject, whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = _copied(whole, tmp_path)
    path = folder / data.draw(st.sampled_from(sorted(p.name for p in whole.iterdir() if p.name not in KEEP)))
    path.write_bytes(data.draw(broken_bytes(path.read_bytes())))
    _all_readers(folder, tmp_path, capsys)


@FUZZ
@given(data=st.data())
def test_a_trial(data: st.DataObject, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.rmtree(tmp_path / "trial", ignore_errors=True)
    folder = make_trial(tmp_path / "trial")
    content = json.loads((folder / "trial.json").read_text())
    (folder / "trial.json").write_text(as_json(data.draw(broken_json(content))))
    answer(capsys, "report", folder)
    assert not leftovers(folder)


def _copied(whole: Path, tmp_path: Path) -> Path:
    folder = tmp_path / "run"
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(whole, folder)
    return folder


def _all_readers(folder: Path, place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Every command that is given a run folder; the page it leaves is whole."""
    said = answer(capsys, "report", folder)
    if said["schema"] == "pamid.report/1":
        assert (folder / "report.html").read_text(encoding="utf-8").rstrip().endswith("</html>")
    answer(capsys, "train-residual", folder, "--iterations", "1", "--hidden", "2", "--jobs", "1")
    answer(capsys, "simulate", "--model", folder, "--excitation", place / "none.csv", "--output", place / "x.csv")
    answer(capsys, "export", folder, "--to", "c", "--output", place / "model")
    assert not leftovers(place)


class Payload:
    """Unpickled, it leaves a file: the proof that code was run."""

    def __init__(self, canary: Path) -> None:
        self.canary = canary

    def __reduce__(self) -> tuple[Any, ...]:
        return (Path.touch, (self.canary,))


def _object_array(canary: Path) -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, weights=np.array([Payload(canary)], dtype=object))
    return buffer.getvalue()


def _bare_pickle(canary: Path) -> bytes:
    return pickle.dumps(Payload(canary))


def _pickle_as_member(canary: Path) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("weights.npy", pickle.dumps(Payload(canary)))
    return buffer.getvalue()


def _endless(canary: Path) -> bytes:
    """A header that promises more numbers than any machine holds."""
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (1099511627776000,), }".ljust(117) + b"\n"
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("weights.npy", b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + b"\0" * 64)
    return buffer.getvalue()


@pytest.mark.parametrize("crafted", [_object_array, _bare_pickle, _pickle_as_member, _endless])
@pytest.mark.parametrize("name", ["network.npz", "checkpoint.npz"])
def test_a_crafted_archive_runs_nothing(crafted: Any, name: str, whole: Path, tmp_path: Path,
                                        capsys: pytest.CaptureFixture[str]) -> None:
    folder, canary = _copied(whole, tmp_path), tmp_path / "canary"
    (folder / name).write_bytes(crafted(canary))
    answer(capsys, "report", folder)
    answer(capsys, "train-residual", folder, "--iterations", "1", "--hidden", "2", "--jobs", "1", "--resume")
    for words in (("simulate", "--model", folder, "--excitation", folder / "residual.csv", "--output", tmp_path / "x"),
                  ("export", folder, "--to", "c", "--output", tmp_path / "model")):
        answer(capsys, *words)
    assert not canary.exists(), "something unpickled it"
