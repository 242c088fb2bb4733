"""Arms in any pose: plain MuJoCo makes the recording, the same model has to follow it."""

from dataclasses import replace
from pathlib import Path

import mechanisms
import numpy as np
import pytest
from posed_arms import FOUR_HINGES, SEVEN_HINGES, SIX_HINGES, Link, arm_text, record_about

from pamid.estimation import robust_fit
from pamid.estimation.grey_box import GreyBox, fit_model
from pamid.estimation.intervals import estimates
from pamid.estimation.problem import Fit
from pamid.estimation.robust_fit import fit_robustly
from pamid.model.registry import rig_named
from pamid.recording.recording import Recording
from pamid.simulation.data_split import split_recordings
from pamid.simulation.replay import channel_mae

SECONDS = 6.0
# mean over channels of the error over the floor; one floor of six windows is off by a third
AT_THE_FLOOR = 1.6


def fitted(model: Path, recording: Recording) -> GreyBox:
    """With all but the masses known: a free armature or shape trades with them."""
    rig = rig_named(str(model))
    zeros = {
        p.outside_name: p.value
        for p in rig.parameters
        if p.fitted and not p.outside_name.endswith("_mass_kg")
    }
    known = replace(recording, known={**recording.known, **zeros})
    return fit_model(split_recordings(rig, [known], []))


def error_over_floor(found: GreyBox) -> float:
    """Held-out errors over the noise floor, mean over the channels."""
    errors, floor = channel_mae(list(found.held_out)), channel_mae(list(found.floor))
    return float(np.mean(errors) / np.mean(floor))


def off_the_truth(found: GreyBox, links: tuple[Link, ...]) -> dict[str, float]:
    """Share by which every fitted mass differs from that of the machine, beyond its interval: a
    base that turns about its axis alone is not determined within seconds."""
    masses = {f"{link.joint}_link_mass_kg": link.mass for link in links}
    off = {}
    for b, e in estimates(found.fit).items():
        true = masses[b.name]
        off[b.name] = 0.0 if e.low <= true <= e.high else abs(e.value / true - 1.0)
    return off


@pytest.mark.parametrize(
    ("seed", "swing"), [(10, 0.6), pytest.param(31, 1.0, marks=pytest.mark.slow)]
)
def test_undamped_arm_of_four_hinges_is_fitted_away_from_zero(seed, swing, tmp_path):
    """Its masses are those of the machine, from ones that are 8 to 15 % off."""
    mechanisms.needs_mujoco()
    pose = np.array([-1.2, 0.5, -1.5, -0.8])
    recording = record_about(FOUR_HINGES, pose, SECONDS, seed, tmp_path / "rec.csv", swing)
    model = tmp_path / "arm.xml"
    model.write_text(arm_text(FOUR_HINGES, np.array([0.85, 1.12, 0.92, 1.1])))
    found = fitted(model, recording)
    assert found.fit.converged, found.fit.why
    assert error_over_floor(found) < AT_THE_FLOOR
    for (b, e), link in zip(estimates(found.fit).items(), FOUR_HINGES, strict=True):
        assert e.value == pytest.approx(link.mass, rel=0.02), b.name
    left = np.concatenate(found.fit.residuals) / found.evidence.noise
    assert np.sqrt(np.mean(left**2)) < 1.2, "the noise alone is left of what was fitted"


def test_the_shape_of_the_last_body_is_fitted_last(tmp_path, monkeypatch):
    """On a motion that the other parameters do not follow yet, it leads into a local minimum."""
    mechanisms.needs_mujoco()
    recording = record_about(FOUR_HINGES, np.zeros(4), SECONDS, 3, tmp_path / "rec.csv", 0.3)
    (tmp_path / "arm.xml").write_text(arm_text(FOUR_HINGES))
    fits: list[Fit] = []

    def recorded(problem, **options):
        fits.append(fit_robustly(problem, **options))
        return fits[-1]

    monkeypatch.setattr(robust_fit, "fit_robustly", recorded)
    rig = rig_named(str(tmp_path / "arm.xml"))
    fit_model(split_recordings(rig, [recording], []))
    first, second = fits[:2]
    keys = second.problem.assembly.keys
    group = rig.on_request["wrist_link_inertia"]
    shape = {keys[p.name] for p in group}
    assert set(second.problem.free) - set(first.problem.free) == shape and len(shape) == 9
    assert [first.p[keys[p.name]] for p in group] == [p.value for p in group]


@pytest.mark.slow
@pytest.mark.parametrize("links", [SIX_HINGES, SEVEN_HINGES], ids=["six", "seven"])
def test_arms_of_robots_are_fitted_in_any_pose(links, tmp_path):
    """The model is the machine, in five random poses: errors at the floor, masses within 2 %."""
    mechanisms.needs_mujoco()
    model = tmp_path / "arm.xml"
    model.write_text(arm_text(links))
    for seed in range(5):
        pose = np.random.default_rng(seed).uniform(-2.0, 2.0, len(links))
        recording = record_about(links, pose, SECONDS, seed, tmp_path / f"rec_{seed}.csv")
        found = fitted(model, recording)
        assert found.fit.converged, (seed, found.fit.why)
        assert error_over_floor(found) < AT_THE_FLOOR, seed
        assert max(off_the_truth(found, links).values()) < 0.02, seed
