"""Every form of export over every kind of model: the program that the form is for gives what pamid
gives, and the command writes it."""

import pytest
from exported import CASES, JUDGES, case, missing
from pamid_cli import frame

#: needed by the judges of these forms
PACKAGES = {"fmu": ("fmpy",), "fmu3": ("fmpy",), "onnx": ("onnx", "onnxruntime")}


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("form", JUDGES)
def test_equal_to_pamid(form, name, tmp_path):
    for package in PACKAGES.get(form, ()):
        pytest.importorskip(package, reason="pip install 'pamid[verify]'")
    if missing(form):
        pytest.skip(missing(form))
    _, run, samples, close = JUDGES[form]
    c = case(name, samples)
    assert c.error(run(name, c.inputs, tmp_path)) < close


@pytest.mark.parametrize(
    ("form", "file"),
    [
        ("c", "pamid_one_dof/pamid_one_dof.c"),
        ("matlab", "pamid_one_dof.m"),
        ("fmu", "pamid_one_dof.fmu"),
        ("fmu3", "pamid_one_dof.fmu"),
        ("onnx", "pamid_one_dof.onnx"),
    ],
)
def test_the_command(form, file, tmp_path, monkeypatch, cli):
    for package in PACKAGES.get(form, ()):
        pytest.importorskip(package, reason="pip install 'pamid[verify]'")
    monkeypatch.setattr(
        "pamid.api.exporting.load_identified",
        lambda *_, **__: case("five effects", 1).model,
    )
    monkeypatch.chdir(tmp_path)
    words = ["export", "run", "--to", form]
    told = cli(*words)
    assert (told["schema"], told["outputs"][0], told["period_s"]) == (
        "pamid.export/1",
        "angle_deg",
        0.003,
    )
    assert file in told["files"] and (tmp_path / file).is_file()
    before = (tmp_path / file).read_bytes()
    assert frame.run(words) == 3
    assert frame.run([*words, "--overwrite"]) == 0
    assert (tmp_path / file).read_bytes() == before
