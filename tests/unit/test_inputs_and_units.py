"""What a rig says of its inputs and units, and what `pamid check` makes of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pamid
from pamid.base.errors import FileError, PamidError, UsageError
from pamid.checks import hold_or_line
from pamid.checks.conformance import ExcitedRig
from pamid.checks.hold_or_line import HoldOrLine, tried_both_ways, wrongly_taken
from pamid.checks.recording_quality import examine
from pamid.model.assembly import Assembly
from pamid.model.parameter import Parameter
from pamid.model.port_guide import reachable
from pamid.model.registry import effects, rig_named
from pamid.model.rig import check_rig
from pamid.recording.recording import Recording, read_recording, recording_of
from pamid.simulation.data_split import split_recordings
from pamid.simulation.free_runs import known_values
from pamid.simulation.virtual_rig import simulate_virtual_rig

ROOT = Path(__file__).resolve().parents[2]
MEASURED = ROOT.parent / "shared" / "data"
PERIOD_S = 0.002


class Oscillator(pamid.Rig):
    """A mass on a spring, 25 Hz, driven by a force and a valve."""

    inputs = {"force_n": "N", "valve_percent": ""}
    optional = {"valve_percent": 0.0}
    ranges = {"valve_percent": (0.0, 100.0)}
    outputs = {"position_mm": "m"}
    ports = {"force": pamid.Port("motion", "N", {"position": "m", "velocity": "m/s"})}
    states = (pamid.State("position", "m"), pamid.State("velocity", "m/s"))
    parameters = (
        Parameter("mass_g", 400.0, low=100.0, high=1000.0, spread=1.3, log=True, source="scale"),
        Parameter("spring", 10.0, 1.0, 100.0, "N/mm", spread=1.5, log=True, source="bent"),
        Parameter("damping", 4.0, 0.1, 50.0, "N s/m", spread=2.0, log=True, source="run-out"),
    )
    period_s = PERIOD_S

    def rates(self, x, u, p, port):  # type: ignore[no-untyped-def]
        force = u.force_n + 20.0 * u.valve_percent - p.spring * x.position - p.damping * x.velocity
        force = port("force", force, position=x.position, velocity=x.velocity)
        return {"position": x.velocity, "velocity": force / p.mass_g}

    def measure(self, x, u, p, port):  # type: ignore[no-untyped-def]
        return {"position_mm": x.position}


def varied(**changes: object) -> pamid.Rig:
    return type("Oscillator", (Oscillator,), {"name": "oscillator", **changes})()


def recorded(way: str, noise: float = 0.0, samples: int = 2500) -> Recording:
    """Of an oscillator whose force is held or linear, off its data sheet; the file says nothing."""
    random = np.random.default_rng(5)
    force = np.convolve(random.standard_normal(samples), [0.3, 0.5, 0.3], "same")
    t = PERIOD_S * np.arange(samples)
    sent = recording_of(t, {"force_n": 10.0 * force, "valve_percent": np.full(samples, 30.0)})
    rig = varied(between={"force_n": way})
    made = simulate_virtual_rig(
        rig, sent, (), {}, {"mass_g": 450.0, "damping_n_s_per_m": 6.0}, 0, 0
    )
    span = float(np.ptp(made.columns["position_mm"]))
    made.columns["position_mm"] += noise * span * random.standard_normal(samples)
    return recording_of(t, made.columns)


# ---- between samples -----------------------------------------------------------------------------


@pytest.mark.parametrize("truth", ["held", "linear"])
@pytest.mark.parametrize("taken", ["held", "linear"])
def test_both_ways_are_tried_and_the_true_one_fits(truth: str, taken: str) -> None:
    (one,) = tried_both_ways(recorded(truth, 0.002), varied(between={"force_n": taken}))
    assert (one.column, one.better, one.wrong) == ("force_n", truth, truth != taken)
    errors = {"held": one.held, "linear": one.linear}
    assert min(errors, key=errors.__getitem__) == truth
    assert one.channel == "position_mm"


def worst_of_both(truth: str) -> tuple[list[HoldOrLine], list[HoldOrLine], list[str]]:
    """Of a recording with two moving inputs, the force held or linear: what the screen leaves, what
    all fits do, and the inputs that the screen has had fitted."""
    recording = recorded(truth, 0.002)
    random = np.random.default_rng(6)
    recording.columns["valve_percent"] = 30.0 + 1e-3 * random.standard_normal(len(recording))
    fitted: list[str] = []
    compared = hold_or_line.compared
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            hold_or_line,
            "compared",
            lambda data, base, column: (fitted.append(column), compared(data, base, column))[1],
        )
        screened = wrongly_taken(recording, varied())
    return screened, [one for one in tried_both_ways(recording, varied()) if one.wrong], fitted


def test_only_an_input_that_may_be_wrong_is_tried() -> None:
    screened, fully, fitted = worst_of_both("linear")
    assert screened == fully and [one.column for one in screened] == ["force_n"]
    assert fitted == ["force_n"]  # the valve's flicker moves nothing
    screened, fully, fitted = worst_of_both("held")
    assert screened == fully == [] and fitted == []


def test_noise_leaves_it_open() -> None:
    (one,) = tried_both_ways(recorded("linear", 0.3), varied())
    assert one.better == "" and not one.wrong


def test_what_a_controller_sends_is_held_and_not_tried() -> None:
    loop = pamid.Loop("force_n", "reference_mm", "position_mm")
    assert tried_both_ways(recorded("linear"), varied(loops=(loop,))) == []


def test_check_says_what_to_write() -> None:
    found = pamid.check(recorded("linear", 0.002), varied())
    assert found.ok, found.summary()
    (note,) = [f for f in found.notes if f.check == "between"]
    assert 'Write between = {"force_n": "linear"} into the rig file' in note.detail
    assert '[between] force_n = "linear" into recording.toml' in note.detail
    (said,) = found.to_dict()["between"]
    assert said["better"] == "linear" and said["rms_linear"] < 0.5 * said["rms_held"]
    better = pamid.check(recorded("linear", 0.002), varied(between={"force_n": "linear"}))
    assert not [f for f in better.notes if f.check == "between"]


def test_a_fit_warns_and_takes_what_is_stated() -> None:
    recording = recorded("linear", 0.002)
    with pytest.warns(UserWarning, match="linear fits clearly better"):
        held = pamid.fit([recording], rig=varied(), progress=False)
    stated = pamid.Recording.from_pandas(recording.to_pandas(), between={"force_n": "linear"})
    fit = pamid.fit([stated], rig=varied(), progress=False)  # a warning is an error here
    assert fit.parameters["mass_g"].value == pytest.approx(450.0, rel=3e-3)
    errors = [one.to_dict()["mae"]["position_mm"]["refitted"] for one in (held, fit)]
    assert errors[0] > 3.0 * errors[1]


# ---- ranges --------------------------------------------------------------------------------------


def test_a_recording_that_leaves_a_range_is_told_where() -> None:
    recording = recorded("held", samples=1000)
    valve = np.full(1000, 30.0)
    valve[400:500] = 130.0
    columns = {**recording.columns, "valve_percent": valve}
    left = recording_of(recording.time, columns)
    (issue,) = [i for i in examine(left, varied()) if i.kind == "beyond-range"]
    assert issue.severity == "advice" and issue.figures["share"] == pytest.approx(0.1)
    assert issue.windows_s[0] == pytest.approx((0.8, 1.0), abs=0.01)
    assert not [i for i in examine(recording, varied()) if i.kind == "beyond-range"]


def test_a_rig_is_tried_within_its_ranges() -> None:
    u = ExcitedRig(varied(optional={})).u[:, 1]
    assert 0.0 <= u.min() < 0.3 and 0.7 < u.max() <= 1.0  # SI: shares


def test_constant_and_missing_inputs_are_welcome() -> None:
    constant = recorded("held", samples=1000)
    assert float(np.ptp(constant.columns["valve_percent"])) == 0.0
    without = recording_of(
        constant.time, {k: v for k, v in constant.columns.items() if k != "valve_percent"}
    )
    for one, rig in ((constant, varied()), (constant, varied(optional={})), (without, varied())):
        assert split_recordings(rig, [one], []).channels == ("position_mm",)
        assert pamid.check(one, rig).ok


# ---- units ---------------------------------------------------------------------------------------


def test_a_parameter_has_the_unit_at_the_end_of_its_name() -> None:
    area = Parameter("area_cm2", 5.0, low=1.0, high=9.0)
    assert (area.unit, area.factor, area.outside_name) == ("cm2", pytest.approx(1e-4), "area_cm2")
    assert Parameter("inertia", 1.0, unit="kg m2").outside_name == "inertia_kg_m2"
    assert Parameter("area_cm2", 5.0, unit="cm2").outside_name == "area_cm2"
    plain = Parameter("side_l", 2.0, unit="1")
    assert plain.factor == 1.0 and plain.outside_name == "side_l"
    assert Parameter("contraction_0", 0.1).unit == ""


@pytest.mark.parametrize(
    ("parameter", "mend"),
    [
        ({"name": "area_cm2", "unit": "mm2"}, "area_mm2"),
        ({"name": "mass_kg", "unit": "N"}, "mass_n"),
        ({"name": "ambient_degc"}, "in K"),
        ({"name": "give_m", "size": "position"}, "'give'"),
    ],
)
def test_units_that_contradict_a_name_are_refused(parameter: dict[str, str], mend: str) -> None:
    with pytest.raises(FileError, match=mend):
        Parameter(value=1.0, **parameter)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("declared", "mend"),
    [
        ({"inputs": {"force_n": "kN", "valve_percent": ""}}, '"force_n": "N"'),
        ({"inputs": {"force_n": "m", "valve_percent": ""}}, '"force_n": "N"'),
        ({"outputs": {"position_mm": "mm"}}, '"position_mm": "m"'),
        ({"outputs": {"position": "m"}}, "position_m"),
        ({"outputs": {"speed_m_s": "m/s"}}, '"speed_m_per_s", here and in the recordings'),
        ({"between": {"force_n": "stepwise"}}, "linear"),
        ({"between": {"forse_n": "held"}}, "force_n"),
        ({"ranges": {"valve_percent": (1.0, 0.0)}}, "lowest, highest"),
    ],
)
def test_what_a_rig_says_of_its_columns_is_checked(declared: dict[str, object], mend: str) -> None:
    with pytest.raises(FileError, match=mend):
        check_rig(varied(**declared), "here")


def test_equations_see_si_and_known_values_any_unit() -> None:
    assembly = Assembly(varied())
    assert assembly.values()[:2] == pytest.approx([0.4, 1e4])
    p, places = known_values(assembly, {"mass_kg": 0.5, "spring_n_per_m": 9e3})
    assert p[places] == pytest.approx([0.5, 9e3])
    p, places = known_values(assembly, {"mass_g": 500.0, "spring_n_per_mm": 9.0})
    assert p[places] == pytest.approx([0.5, 9e3])
    with pytest.raises(FileError):
        assembly.index_of("mass_mm")


@pytest.mark.parametrize("written", ["Nm", "N*m", "N m"])
def test_a_torque_port_offers_gravity_and_an_angular_velocity(written: str) -> None:
    port = pamid.Port("motion", written, ("position", "velocity"))
    assert (port.unit, port.unit_of("velocity")) == ("N m", "rad/s")
    assert "gravity" in {n for names in reachable(port, effects().values()).values() for n in names}


@pytest.mark.parametrize(
    ("declared", "mend"),
    [
        (("motion", "bananas"), "'bananas' is not a unit"),
        (("motion", "N", {"velocity": "bananas"}), "'bananas' is not a unit"),
        (("motion", "kN"), "the equations see SI"),
    ],
)
def test_a_port_has_an_si_unit(declared: tuple[object, ...], mend: str) -> None:
    with pytest.raises(FileError, match=mend):
        pamid.Port(*declared)  # type: ignore[arg-type]


# ---- exports -------------------------------------------------------------------------------------


def test_a_model_with_a_linear_input_is_run_and_not_exported(tmp_path: Path) -> None:
    from pamid.correction.identified_model import load_identified
    from pamid.export.exporting import export_model
    from pamid.export.form import known_forms

    recording = pamid.Recording.from_pandas(
        recorded("linear", 0.002).to_pandas(), between={"force_n": "linear"}
    )
    pamid.fit([recording], rig=Oscillator, progress=False, output=tmp_path / "run")
    model = load_identified(tmp_path / "run", rig=Oscillator())
    assert model.equations.linear == ("force_n",), "as the recording said, not the rig"
    again = pamid.simulate(recording, model=tmp_path / "run", rig=Oscillator, noise=0.0)
    off = again.columns["position_mm"] - recording.columns["position_mm"]
    assert np.abs(off[200:]).max() < 0.02 * np.ptp(recording.columns["position_mm"])
    sampled = [name for name, form in known_forms().items() if form.sampled]
    assert sampled
    for form in sampled:
        with pytest.raises(UsageError, match="held"):
            export_model(model, form, tmp_path / "out")


# ---- measured ------------------------------------------------------------------------------------

SILVERBOX = '''"""An electronic oscillator."""
from pamid import Parameter, Port, Rig, State


class Silverbox(Rig):
    """Oscillator, its drive held or not."""

    inputs = {"drive_v": "V"}
    outputs = {"response_v": "V"}
    ports = {"spring": Port("motion", "V", {"position": "V", "velocity": "V/s"})}
    states = (State("position", "V"), State("velocity", "V/s"))
    parameters = (
        Parameter("frequency", 60.0, 20.0, 200.0, "Hz", log=True, spread=1.5, source="guess"),
        Parameter("damping", 0.05, 0.001, 1.0, log=True, spread=3.0, source="guess"),
        Parameter("gain", 1.0, 0.1, 10.0, log=True, spread=2.0, source="guess"),
        Parameter("offset", 0.0, -0.1, 0.1, "V", source="guess"),
    )
    period_s = 1.6384e-3

    def rates(self, x, u, p, port):
        w = 6.283185307179586 * p.frequency
        pull = p.gain * u.drive_v + p.offset - x.position
        pull = port("spring", pull, position=x.position, velocity=x.velocity)
        return {"position": x.velocity, "velocity": w * (w * pull - 2.0 * p.damping * x.velocity)}

    def measure(self, x, u, p, port):
        return {"response_v": x.position}
'''


@pytest.mark.parametrize(("name", "most"), [("multisine", 0.5), ("tail", 0.4), ("arrow", 0.8)])
def test_the_silverbox_drive_is_linear(name: str, most: float, tmp_path: Path) -> None:
    """Half a sample hid nine tenths of its cubic spring."""
    path = MEASURED / "silverbox" / f"{name}.csv"
    if not path.exists():
        pytest.skip(f"{path} is absent: see data/README.md")
    rig = tmp_path / "silverbox.py"
    rig.write_text(SILVERBOX)
    (one,) = tried_both_ways(read_recording(path), rig_named(str(rig)))
    assert one.better == "linear" and one.wrong and one.linear < most * one.held


# ---- ports ---------------------------------------------------------------------------------------


def test_the_page_is_as_the_catalogue_is() -> None:
    from port_page import PAGE, written

    page = PAGE.read_text(encoding="utf-8")
    assert written(page) == page, "run python tests/support/port_page.py"


def test_check_of_a_rig_says_what_each_signal_would_unlock() -> None:
    found = pamid.check(ROOT / "data" / "rigs" / "cart.py")
    force, sensor = found.to_dict()["ports"]
    assert (force["port"], force["kind"], force["unit"]) == ("force", "motion", "N")
    unlocked = {tuple(one["signals"]): one["effects"] for one in force["unlocks"]}
    for signals, names in unlocked.items():
        for name in names:
            assert name not in force["effects"]
            assert set(signals) <= set(effects()[name].signals)
    assert "load-dependent-friction" in unlocked["load",]
    assert not force["imposed"] and sensor["kind"] == "reading"
    assert "with load: load-dependent-friction" in found.summary()
    assert force["sign"].replace("`", "") in " ".join(found.summary().split())


def test_an_imposed_motion_is_pointed_at() -> None:
    found = pamid.check(ROOT / "data" / "rigs" / "piston_bench.py")
    assert [row["imposed"] for row in found.to_dict()["ports"]] == [True, False]
    assert "shows the opposite of what passes" in " ".join(found.summary().split())


def test_the_seal_of_the_piston_rubs_with_the_sign_that_the_bench_states() -> None:
    """Least squares on the measured forces: area, offset, and the level of a friction that is taken
    off along the velocity of what the port passes, which is positive."""
    folder = MEASURED / "piston_friction"
    if not folder.exists():
        pytest.skip(f"{folder} is absent: see data/README.md")
    rows = []
    for bar in (1, 3, 7):
        r = read_recording(folder / f"oring_{bar}bar.csv")
        position = np.convolve(r.signal("position_mm"), np.ones(15) / 15.0, "same")
        velocity = np.gradient(position, r.sampling_period_s)
        air = 1e5 * 1e-4 * r.signal("pressure_bar")
        moves = np.abs(velocity) > 0.5
        table = np.stack([air, np.ones(len(r)), np.sign(velocity), r.signal("force_n")], axis=1)
        rows.append(table[moves])
    table = np.concatenate(rows)
    area, _, friction = np.linalg.lstsq(table[:, :3], table[:, 3], rcond=None)[0]
    assert 4.0 < area < 6.0
    # along = offset - air - friction sign(velocity), and the cell reads its negative
    assert 3.0 < friction < 9.0
    assert rig_named(str(ROOT / "data" / "rigs" / "piston_bench.py")).ports["piston"].size


def test_errors_of_a_rig_file_reach_check(tmp_path: Path) -> None:
    path = tmp_path / "cart.py"
    text = (ROOT / "data" / "rigs" / "cart.py").read_text()
    path.write_text(text.replace('{"force_n": "N"}', '{"force_n": "kN"}'))
    found = pamid.check(path)
    assert not found.ok and "the equations see SI" in found.problems[0].detail
    with pytest.raises(PamidError, match="the equations see SI"):
        rig_named(str(path))
