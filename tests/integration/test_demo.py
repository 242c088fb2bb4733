"""`pamid demo`: from nothing to a report page, with an effect that the diagnosis is not told."""

import json

import pytest
from pamid_cli import frame
from pamid_cli.demo import demo_text

import pamid.api.replications.demonstration as demo
from pamid.base.json_file import read_json
from pamid.model.registry import effects, rig_named
from pamid.recording.recording import read_recording
from pamid.simulation.virtual_rig import attach_specs, split_spec

FILES = (
    "run.json",
    "excitation.csv",
    "rec.csv",
    "rec.toml",
    "withheld.json",
    "fit.json",
    "residual.csv",
    "diagnosis.json",
    "network.json",
    "network.npz",
    "trace.csv",
    "report.html",
)


def seed_of(effect: str) -> int:
    return next(seed for seed in range(1000) if demo.draw_withheld(seed).effect == effect)


@pytest.mark.slow
def test_a_short_demo_names_what_was_withheld(tmp_path, monkeypatch, capsys, cli):
    folder = tmp_path / "demo"

    def blind(*given, **options):
        """Diagnose with the truth out of reach."""
        truth = (folder / demo.TRUTH_FILE).rename(tmp_path / "elsewhere.json")
        found = unpatched(*given, **options)
        truth.rename(folder / demo.TRUTH_FILE)
        return found

    unpatched = demo.diagnose
    monkeypatch.setattr(demo, "diagnose", blind)
    seed = str(seed_of("valve-dead-band"))
    words = ["--output", str(folder), "--seed", seed, "--duration", "15", "--json"]
    assert frame.run(["demo", *words]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["hit"] == "right" and found["verdict"] == "explained"
    (cause,) = found["causes"]
    assert cause["effect"] == found["withheld"]["effect"] == "valve-dead-band"
    assert cause["parameters"]["dead_band"]["value"] == pytest.approx(0.08, rel=0.05)
    for name, truth in found["withheld"]["parameters"].items():
        assert truth == pytest.approx(
            found["withheld"]["over_data_sheet"][name] * found["parameters"][name]["prior"]
        )
    assert found["parameters"]["damping_m2_s"]["value"] == pytest.approx(
        found["withheld"]["parameters"]["damping_m2_s"], rel=0.02
    )
    assert [name for name in FILES if not (folder / name).is_file()] == []
    record = read_json(folder / "run.json")
    assert record["ended"] and [step["outcome"] for step in record["steps"]] == ["done", "done"]
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "valve dead band" in page.lower().replace("-", " ") and "did not end" not in page
    told = read_recording(folder / "rec.csv")
    assert not told.known and "dead" not in (folder / "rec.toml").read_text()
    # a folder that is taken
    assert "--overwrite" in cli("demo", "--output", folder, code=3)["hint"]
    text = demo_text(found, folder)
    assert "Right: " in text and "Withheld  valve-dead-band" in text
    # the network goes on from where the demo left it
    more = str(demo.ITERATIONS + 1)
    words = ["--seed", seed, "--iterations", more, "--resume"]
    assert frame.run(["train-residual", str(folder), *words]) == 0
    assert read_json(folder / "network.json")["training"]["iterations"] == demo.ITERATIONS + 1


def test_every_effect_is_drawn_and_parameters_are_off_by_10_to_20_percent():
    drawn = [demo.draw_withheld(seed) for seed in range(60)]
    assert {w.spec for w in drawn} == set(demo.WITHHELD_EFFECTS)
    assert drawn[5] == demo.draw_withheld(5)
    off = [abs(factor - 1.0) for w in drawn for factor in w.factors.values()]
    assert min(off) >= 0.0999 and max(off) <= 0.2001
    assert all(w.family == effects()[w.effect].family for w in drawn)


def test_the_list_is_of_the_catalogue():
    rig = rig_named(demo.DEMO_RIG)
    names = {p.outside_name for p in rig.parameters if p.fitted}
    assert set(demo.MISTUNED) <= names
    assert {a.effect.name for a, _ in attach_specs(rig, demo.WITHHELD_EFFECTS)} == {
        split_spec(s)[0] for s in demo.WITHHELD_EFFECTS
    }


@pytest.mark.slow
@pytest.mark.parametrize("effect", [split_spec(spec)[0] for spec in demo.WITHHELD_EFFECTS])
def test_the_whole_demo_for_every_effect(effect, tmp_path, capsys):
    words = f"demo --output {tmp_path}/demo --seed {seed_of(effect)} --json"
    assert frame.run(words.split()) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["hit"] == "right", found["sentence"]
