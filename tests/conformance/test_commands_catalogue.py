"""`pamid effects`, `pamid rigs`, `pamid check`: the catalogue is complete, and what is wrong is
said in full."""

import json
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest
from pamid_cli.frame import run
from pamid_cli.table import every_command

from pamid.base.symptoms import SYMPTOMS
from pamid.intake.checks.conformance import (
    EveryPortRig,
    ExcitedRig,
    rig_findings,
)
from pamid.model import catalogue
from pamid.model import registry as library
from pamid.model.assembly import Assembly
from pamid.model.attachment import attach
from pamid.model.effect import SECTIONS
from pamid.recording.recording import write_recording

RIGS = Path(__file__).parents[2] / "data" / "rigs"

EFFECT = '''"""A push of a kind.

What it is
    A push.
What it looks like
    Pushed.
Looks like it
    A pull.
Equation
    value += size
References
    Nobody (2001), A Journal 1(1).
"""

from pamid.model.effect import Effect
from pamid.engine.symbolic.vocabulary import floor, sqrt
from pamid.model.parameter import Parameter


class Push(Effect):
    """A push."""

    family = "offset"
    general_kinds = ("motion",)
    parameters = (Parameter("amount", 0.1, low=-1.0, high=1.0, null=0.0, source="test"),)

    def act(self, value, at, p, z):
        return {result}
'''


def call(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> tuple[int, dict[str, Any]]:
    """Exit code and the JSON object of `pamid ... --json`."""
    code = run([*map(str, arguments), "--json"])
    return code, json.loads(capsys.readouterr().out)


def wrong(said: dict[str, Any]) -> list[str]:
    return [f["check"] for f in said["findings"] if not f["ok"] and not f["advice"]]


def effect_file(folder: Path, result: str) -> Path:
    path = folder / "push.py"
    path.write_text(EFFECT.format(result=result), encoding="utf-8")
    return path


# ---- effects --------------------


def test_list_of_effects_is_the_scanned_catalogue(capsys):
    code, said = call(capsys, "effects")
    assert code == 0 and said["schema"] == "pamid.effects/1"
    assert [row["name"] for row in said["effects"]] == sorted(library.effects())
    assert all(row["families"] and row["title"] for row in said["effects"])
    assert run(["effects"]) == 0
    shown = capsys.readouterr().out
    assert all(f"  {name} " in shown for name in library.effects())


def test_free_forms_are_listed_when_asked_for(capsys):
    said = call(capsys, "effects", "--free-forms")[1]
    assert [row["name"] for row in said["effects"]] == sorted(library.all_effects())
    assert not set(library.free_form_effects()) & set(library.effects())
    for name in library.free_form_effects():
        code, said = call(capsys, "effects", name, "--rig", "one-dof")
        assert code == 0 and said["effect"]["name"] == name and said["effect"]["parameters"]


def test_list_of_effects_for_one_rig_leaves_out_what_does_not_fit(capsys):
    joint = {row["name"] for row in call(capsys, "effects", "--rig", "one-dof")[1]["effects"]}
    drive = {
        row["name"] for row in call(capsys, "effects", "--rig", RIGS / "emps.py")[1]["effects"]
    }
    assert "coulomb-friction" in joint & drive
    assert "angle-sensor-lag" in joint and "first-order-lag" not in joint
    assert "first-order-lag" in drive and "angle-sensor-lag" not in drive


def test_every_effect_tells_its_story(capsys):
    servo = Path(__file__).parents[1] / "rigs" / "geared_servo.py"
    files = [library.rig_named(str(path)) for path in (RIGS / "emps.py", servo)]
    rigs = [library.rig_named("one-dof"), *files, EveryPortRig()]
    known = library.effects()
    for name, effect in known.items():
        said = catalogue.effect_story(effect, rigs, known.values())
        assert set(SECTIONS) <= set(said.story), name
        assert said.places and said.parameters, name
        shown = catalogue.effect_text(said)
        assert all(p.name in shown for p in said.parameters), name
        json.dumps(said.as_json(), allow_nan=False)


def test_story_names_parameters_as_the_rig_does(capsys):
    code, said = call(capsys, "effects", "viscous-friction", "--rig", RIGS / "emps.py")
    (place,) = said["effect"]["places"]
    assert (code, place["ports"]) == (0, ["force"])
    assert place["parameters"] == [{"name": "damping_n_s_per_m", "unit": "N s/m"}]
    assert said["effect"]["absorbed_by"] == ["viscous", "damping"]


def test_an_effect_of_ones_own_is_explained_from_its_file(tmp_path, capsys):
    path = effect_file(tmp_path, "value + p.amount")
    code, said = call(capsys, "effects", path, "--rig", RIGS / "emps.py")
    assert (code, said["effect"]["name"], said["effect"]["places"][0]["effect"]) == (
        0,
        "push",
        "push",
    )


def test_effects_are_listed_by_symptom(capsys):
    known = library.effects()
    assert all(kind.symptoms for kind in known.values())
    assert {s for kind in known.values() for s in kind.symptoms} == set(SYMPTOMS)
    rows = call(capsys, "effects", "--symptom", "stops-short")[1]["effects"]
    names = {row["name"] for row in rows}
    assert "coulomb-friction" in names and "dead-time" not in names
    assert all("stops-short" in row["symptoms"] for row in rows)


# ---- rigs --------------------


def test_list_of_rigs_is_the_scanned_catalogue(capsys):
    code, said = call(capsys, "rigs")
    assert code == 0 and said["schema"] == "pamid.rigs/1"
    assert {row["name"] for row in said["rigs"]} == set(library.rigs())


def test_story_of_a_rig_writes_ports_into_its_equations(capsys):
    code, said = call(capsys, "rigs", "one-dof")
    rig = said["rig"]
    assert code == 0
    assert rig["equations"]["rates"]["d velocity/dt"] == "arm / inertia"
    assert rig["equations"]["ports"]["arm"] == "joint"
    assert "chain[1]" in rig["equations"]["ports"]["joint"]
    assert {p["name"] for p in rig["ports"]} == set(library.rig_named("one-dof").ports)
    assert all(p["source"] for p in rig["parameters"])
    assert run(["rigs", "one-dof"]) == 0
    assert "conductance_in" in capsys.readouterr().out


@pytest.mark.parametrize("name", ["emps.py", "cart.py"])
def test_rig_files_of_the_data_folder_are_sound(name, capsys):
    code, said = call(capsys, "rigs", RIGS / name)
    assert code == 0 and said["rig"]["equations"]["rates"]["d position/dt"] == "velocity"
    code, said = call(capsys, "check", RIGS / name)
    assert code == 0 and wrong(said) == []
    fit = next(f["detail"] for f in said["findings"] if f["check"] == "effects")
    assert "coulomb-friction" in fit and "quadratic-drag" in fit


# ---- check: rigs and effects --------------------


@pytest.mark.parametrize(
    ("result", "check"),
    [
        ("value + p.amount + 1e-3", "null"),
        ("value + p.amount * (1.0 / sqrt(0.5 - p.amount))", "finite"),
        ("value + p.amount * 0.5 + floor(p.amount * 1e9) * 0.5e-9", "sensitivities"),
        ("value + p.amont", "equations"),
    ],
)
def test_check_catches_an_effect_that_misbehaves(result, check, tmp_path, capsys):
    code, said = call(capsys, "check", effect_file(tmp_path, result))
    assert code == 3 and set(wrong(said)) == {check}
    if check == "equations":
        assert "amount" in said["message"]


def test_check_passes_a_sound_effect_and_says_where_it_was_tried(tmp_path, capsys):
    path = effect_file(tmp_path, "value + p.amount")
    code, said = call(capsys, "check", path)
    assert (code, said["kind"], said["effects"], wrong(said)) == (0, "effect", ["push"], [])
    tried = [f["detail"] for f in said["findings"] if f["check"] == "null"]
    assert any("every-port-rig, push" in detail for detail in tried)
    assert run(["check", str(path)]) == 0
    *_, verdict, follow = capsys.readouterr().out.rstrip().splitlines()
    assert verdict == "nothing is wrong" and follow.startswith("Next: pamid diagnose")


def test_check_lists_every_gap_of_a_data_sheet(tmp_path, capsys):
    path = effect_file(tmp_path, "value + p.amount")
    bare = path.read_text(encoding="utf-8").replace(
        "References\n    Nobody (2001), A Journal 1(1).\n", ""
    )
    path.write_text(
        bare.replace(', source="test"', "").replace('family = "offset"', 'family = ""'),
        encoding="utf-8",
    )
    code, said = call(capsys, "check", path)
    assert code == 3 and wrong(said) == ["data sheet"] * 3
    assert all(word in str(said["findings"]) for word in ("'References'", "no family", "no source"))


# ---- check: recordings --------------------


def recording(folder: Path, **changes: Any) -> Path:
    time = 0.001 * np.arange(300)
    columns = {
        "force_n": np.where(time < 0.1, 0.0, 1.0 + np.sin(60.0 * time)),
        "position_m": np.maximum(time - 0.1, 0),
    }
    write_recording(
        folder / "rec.csv", time, {**columns, **changes}, {"recording": {"loop": "open"}}
    )
    return folder / "rec.csv"


def test_check_says_what_is_in_a_recording(tmp_path, capsys):
    path = recording(tmp_path, spare_v=np.full(300, 2.5), drive_v=np.zeros(300))
    code, said = call(capsys, "check", path, "--rig", RIGS / "emps.py")
    assert (code, said["kind"], said["samples"], said["sampling_period_s"]) == (
        0,
        "recording",
        300,
        0.001,
    )
    position = said["columns"]["position_m"]
    assert position["rest_s"] == pytest.approx(0.1 + 0.02 * 0.199, abs=0.002)
    assert (position["low"], position["high"], position["unit"]) == (0.0, pytest.approx(0.199), "m")
    assert said["columns"]["spare_v"]["constant"] and not position["constant"]
    assert any("'spare_v'" in f["detail"] for f in said["findings"] if f["check"] == "column")


def test_check_lists_every_problem_of_a_recording(tmp_path, capsys):
    path = recording(tmp_path)
    lines = path.read_text(encoding="utf-8").splitlines()
    lines[5] = lines[5].rsplit(",", 1)[0] + ",nan"
    lines[9] = lines[8]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    path.with_suffix(".toml").write_text('[recording]\nloop = "opne"\n', encoding="utf-8")
    code, said = call(capsys, "check", path)
    assert code == 3 and {"cell", "stamps-repeated", "toml"} <= set(wrong(said))
    assert any("line 6" in f["detail"] for f in said["findings"])


# ---- the checks themselves --------------------


def test_the_bench_is_sound_and_offers_a_port_of_every_kind():
    from pamid.model.effect import KINDS

    assert {port.kind for port in EveryPortRig.ports.values()} == set(KINDS)
    assert [f for f in rig_findings(EveryPortRig(), library.effects().values()) if f.wrong] == []


def test_clock_skew_shifts_every_reading_by_the_same_time():
    rig = EveryPortRig()
    trial = ExcitedRig(rig, attach(rig, "clock-skew", library.effects()))
    assert set(trial.attachment.ports if trial.attachment else ()) == {
        "ruler",
        "dial",
        "gauge",
        "cell",
    }
    p = trial.assembly.values({"clock-skew:start_s": 3 * rig.period_s, "clock-skew:skew_ppm": 0.0})
    plain = ExcitedRig(rig).run(Assembly(rig).values(), trial.stepping(p))
    late = trial.run(p, trial.stepping(p))
    np.testing.assert_allclose(late[3:], plain[:-3], rtol=1e-9, atol=1e-12)


def test_clock_skew_leads_an_early_reading_by_its_slope():
    rig = EveryPortRig()
    trial = ExcitedRig(rig, attach(rig, "clock-skew", library.effects()))
    p = trial.assembly.values({"clock-skew:start_s": -rig.period_s, "clock-skew:skew_ppm": 0.0})
    plain = ExcitedRig(rig).run(Assembly(rig).values(), trial.stepping(p))[:, 0]
    early = trial.run(p, trial.stepping(p))[:, 0]
    assert np.abs(early[:-1] - plain[1:]).max() < 0.05 * np.abs(plain[1:] - plain[:-1]).max()


# ---- options alike -----------------------------------------------------------------------------


def options_of(command: click.Command) -> dict[str, click.Option]:
    """Name as it is typed -> option, of those that the help shows."""
    return {
        name: one
        for one in command.params
        if isinstance(one, click.Option) and not one.hidden
        for name in one.opts
    }


def test_whoever_writes_may_be_told_where_and_need_not_be():
    """--output has a default everywhere, stands beside --overwrite, and so does --figure."""
    for command in every_command():
        options = options_of(command)
        for name in {"--output", "--figure"} & set(options):
            assert not options[name].required, (command.name, name)
            assert "--overwrite" in options, (command.name, name)
        assert {"--json", "--debug"} <= set(options), command.name


def test_what_can_be_interrupted_can_be_gone_on_with_or_replaced():
    for command in every_command():
        options = options_of(command)
        if "--cluster" in options:
            assert {"--resume", "--overwrite", "--jobs", "--seed"} <= set(options), command.name
