"""What an experiment would show is what it shows: visibility foretold, and that of a fit; what
parameters take up does not show; the command, its picture and its refusals."""

from dataclasses import replace

import numpy as np
import pytest
from pamid_cli.frame import run as run_command

import pamid
from pamid.base.schemas.command_files import ShownEffect
from pamid.estimation.grey_box import fit_model
from pamid.model.registry import rig_named
from pamid.recording.recording import Recording, recording_of
from pamid.simulation.data_split import Span, split_recordings

PENDULUM = "servo-pendulum"  # its weight holds it: nothing drifts without end
PERIOD_S, SAMPLES, NOISE = 0.01, 1500, 3.0


@pytest.fixture(scope="module")
def excitation() -> Recording:
    """Half a second at every voltage."""
    levels = np.repeat(np.random.default_rng(3).uniform(-2.0, 2.0, SAMPLES // 50), 50)
    meta = {"recording": {"sampling_period_s": PERIOD_S, "loop": "open"}}
    return recording_of(PERIOD_S * np.arange(SAMPLES), {"voltage_v": levels}, meta, name="levels")


@pytest.fixture(scope="module")
def found(excitation) -> pamid.PowerResult:
    return pamid.power(excitation, PENDULUM, noise=NOISE, progress=False)


def effect(found: pamid.PowerResult, label: str) -> ShownEffect:
    return next(e for e in found.effects if e.effect == label)


def test_what_a_parameter_takes_up_does_not_show(found):
    """A gain of the voltage is another constant of the motor, more damping another damping."""
    assert {"gain-error@driver", "viscous-friction"} <= set(found.hidden)
    assert "coulomb-friction" in found.showing


def test_the_visibility_that_is_foretold_is_that_of_a_fit(found, excitation):
    told = effect(found, "coulomb-friction")
    assert told.amount is not None
    planted = f"coulomb-friction:{told.amount.parameter}={told.amount.usual!r}"
    errors = []
    for effects in ((planted,), ()):
        recording = pamid.simulate(excitation, PENDULUM, effects=effects, noise=NOISE, seed=5)
        split = split_recordings(rig_named(PENDULUM), [recording], [])
        split = replace(split, fit=(Span(split.recordings[0], 0, len(recording)),))
        (left,) = fit_model(split).fit.residuals
        errors.append(float(np.sqrt(np.mean(left**2))))
    above = [np.sqrt(v**2 - 1.0) for v in (errors[0] / errors[1], told.visible[2])]
    # to first order; the fit begins its windows anew and weighs by its own residuals
    assert above[0] == pytest.approx(above[1], rel=0.25) and above[1] > 0.5


def test_the_command_says_it_and_draws_it(excitation, tmp_path, capsys, cli):
    sent, picture = tmp_path / "levels.csv", tmp_path / "power.png"
    pamid.write_recording(
        sent,
        PERIOD_S * np.arange(SAMPLES),
        {"voltage_v": excitation.columns["voltage_v"]},
        {"recording": {"sampling_period_s": PERIOD_S, "loop": "open"}},
    )
    asked = ["power", "--rig", PENDULUM, "--excitation", str(sent), "--jobs", "1"]
    said = cli(*asked, "--figure", picture)
    assert said["schema"] == "pamid.power/1" and len(said["effects"]) > 20
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert run_command([*asked, "--figure", str(tmp_path / "power.gif")]) == 2
    assert "power.png" in capsys.readouterr().err
    assert run_command([*asked, "--figure", str(picture)]) != 0, "nothing is overwritten unasked"
