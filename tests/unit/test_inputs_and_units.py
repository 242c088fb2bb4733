"""What a rig says of its inputs and units, and what `pamid check` makes of it."""

import numpy as np
import pytest

import pamid
from pamid.base.errors import FileError, UsageError
from pamid.intake.checks.sampling_slips import compare_holds
from pamid.model.assembly import Assembly
from pamid.model.parameter import Parameter
from pamid.model.rig import check_rig
from pamid.recording.recording import Recording, recording_of
from pamid.simulation.free_runs import known_values
from pamid.simulation.virtual_rig import simulate_virtual_rig

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
def test_both_ways_are_tried_and_the_true_one_fits(truth, taken):
    (one,) = compare_holds(recorded(truth, 0.002), varied(between={"force_n": taken}))
    assert (one.column, one.better, one.wrong) == ("force_n", truth, truth != taken)
    errors = {"held": one.rms_held, "linear": one.rms_linear}
    assert min(errors, key=errors.__getitem__) == truth
    assert one.channel == "position_mm"


def test_check_says_what_to_write():
    found = pamid.check(recorded("linear", 0.002), varied())
    assert found.ok, found.summary()
    (note,) = [f for f in found.notes if f.check == "between"]
    assert 'Write between = {"force_n": "linear"} into the rig file' in note.detail
    assert '[between] force_n = "linear" into recording.toml' in note.detail
    (said,) = found.to_dict()["between"]
    assert said["better"] == "linear" and said["rms_linear"] < 0.5 * said["rms_held"]
    better = pamid.check(recorded("linear", 0.002), varied(between={"force_n": "linear"}))
    assert not [f for f in better.notes if f.check == "between"]


# ---- units ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("parameter", "mend"),
    [
        ({"name": "area_cm2", "unit": "mm2"}, "area_mm2"),
        ({"name": "mass_kg", "unit": "N"}, "mass_n"),
        ({"name": "ambient_degc"}, "in K"),
        ({"name": "give_m", "size": "position"}, "'give'"),
    ],
)
def test_units_that_contradict_a_name_are_refused(parameter, mend):
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
def test_what_a_rig_says_of_its_columns_is_checked(declared, mend):
    with pytest.raises(FileError, match=mend):
        check_rig(varied(**declared), "here")


def test_equations_see_si_and_known_values_any_unit():
    assembly = Assembly(varied())
    assert assembly.values()[:2] == pytest.approx([0.4, 1e4])
    p, places = known_values(assembly, {"mass_kg": 0.5, "spring_n_per_m": 9e3})
    assert p[places] == pytest.approx([0.5, 9e3])
    p, places = known_values(assembly, {"mass_g": 500.0, "spring_n_per_mm": 9.0})
    assert p[places] == pytest.approx([0.5, 9e3])
    with pytest.raises(FileError):
        assembly.index_of("mass_mm")


# ---- exports -------------------------------------------------------------------------------------


def test_a_model_with_a_linear_input_is_run_and_not_exported(tmp_path):
    from pamid.exports.exporting import export_model
    from pamid.exports.form import known_forms
    from pamid.networks.correction.identified_model import load_identified

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
