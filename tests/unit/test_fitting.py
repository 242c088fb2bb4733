"""Grey-box fits: planted parameters come back with honest intervals, priors rule where the data are
silent."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from virtual_joint import KNOWN, SPECIMEN, record

from pamid.base.parallel.jobs import WorkerPool
from pamid.base.schemas.estimates import Estimate
from pamid.engine.program import Stepping
from pamid.estimation.fit_files import fit_json
from pamid.estimation.grey_box import GreyBox, fit_model
from pamid.estimation.intervals import bootstrap, estimates
from pamid.estimation.linear_rows import linear_rows
from pamid.estimation.multiple_shooting import fit
from pamid.estimation.problem import Fit, FitStart, Problem, free_parameters
from pamid.estimation.robust_fit import fit_robustly
from pamid.model.assembly import Assembly
from pamid.model.bound_parameter import Bound
from pamid.model.effect import State
from pamid.model.parameter import Parameter
from pamid.model.registry import rig_named
from pamid.model.rig import Port, Rig
from pamid.recording.recording import Recording, read_recording, write_recording
from pamid.simulation.data_split import split_recordings
from pamid.simulation.free_runs import virtual_recording
from pamid.simulation.rig_data import data_of
from pamid.simulation.tracks import track_of
from pamid.simulation.windows import Runner

JOINT = rig_named("one-dof")


def problem_of(rig: Rig, *recordings: Recording, window_s: float = 1.5) -> Problem:
    channels = tuple(c for c in rig.outputs if all(r.has(c) for r in recordings))
    a = Assembly(rig, outputs=channels)
    tracks = tuple(track_of(a, data_of(a.rig, r), channels) for r in recordings)
    return Problem(a, tracks, free_parameters(a, tracks), window_s)


@cache
def recorded(seed: int = 1, seconds: float = 12.0, columns: tuple[str, ...] = ()) -> Recording:
    with TemporaryDirectory() as folder:
        return record(Path(folder) / "rec.csv", seconds, seed=seed, columns=columns)


@cache
def fitted_joint(seed: int = 1) -> Fit:
    return fit_robustly(problem_of(JOINT, recorded(seed)))


def test_a_fit_that_used_up_its_steps_goes_on(monkeypatch):
    """Else an effect would be named for what its refit gains in the other parameters."""

    most = 2

    def few_steps(*args, iterations=2, **options):
        return fit(*args, iterations=min(iterations, most), **options)

    monkeypatch.setattr("pamid.estimation.robust_fit.fit", few_steps)
    done, wanted = fit_robustly(problem_of(JOINT, recorded())), fitted_joint()
    assert done.converged and done.cost == pytest.approx(wanted.cost, rel=0.02)
    most = 1
    monkeypatch.setattr("pamid.estimation.robust_fit.ROUNDS", 2)  # too few
    assert not fit_robustly(problem_of(JOINT, recorded())).converged


def by_name(found: dict[Bound, Estimate]) -> dict[str, Estimate]:
    return {b.full_name: e for b, e in found.items()}


# ---- one joint --------------------


def test_planted_parameters_lie_within_their_intervals():
    inside, count = 0, 0
    for seed in (1, 2, 3):
        for name, e in by_name(estimates(fitted_joint(seed))).items():
            inside += e.low <= SPECIMEN[name] <= e.high
            count += 1
            assert abs(e.value - SPECIMEN[name]) < 0.25 * abs(SPECIMEN[name]), (name, e)
            assert e.low <= e.value <= e.high
    assert count == 3 * len(SPECIMEN)
    assert inside >= 0.8 * count, f"{inside} of {count}: intervals of 95 % promise more"


def test_refitting_from_elsewhere_finds_the_same_optimum():
    """The prior's mean stays the data sheet, wherever the search begins."""
    done = fitted_joint(2)
    problem = done.problem
    moved = done.p.copy()
    for sign, i in zip(np.resize([1.0, -1.0], len(problem.free)), problem.free, strict=True):
        b = problem.assembly.parameters[i]
        moved[i] = np.clip(moved[i] * (1.0 + 0.1 * sign), b.low, b.high)
    start = FitStart(done.p, weights=done.weights, stepping=done.stepping)
    one, other = (
        fit(problem, begun, iterations=200, tolerance=1e-6)
        for begun in (start, replace(start, p=moved))
    )
    assert one.converged and other.converged
    scale, free = done.problem.scale, list(problem.free)
    apart = np.abs(scale.inside(one.p[free]) - scale.inside(other.p[free])) / np.sqrt(
        one.covariance.diagonal()
    )
    assert apart.max() < 0.1
    assert other.cost == pytest.approx(one.cost, rel=1e-4)


def test_elimination_of_window_starts_equals_a_dense_solution():
    done = fit(problem_of(JOINT, recorded(4, 6.0)))
    rows = linear_rows(done, 10**9)  # as tests/unit/test_linear_rows.py holds against differences
    J = np.column_stack([rows.by_parameters, rows.by_starts])
    size, free = np.linalg.norm(J, axis=0), len(done.problem.free)
    spread = np.sqrt(np.linalg.inv((J / size).T @ (J / size)).diagonal()) / size
    np.testing.assert_allclose(np.sqrt(done.covariance.diagonal()), spread[:free], rtol=2e-2)


def test_bootstrap_is_reproducible_and_of_the_jacobians_order():
    done = fitted_joint()
    draws = bootstrap(done, 24, seed=5)
    np.testing.assert_array_equal(draws[:6], bootstrap(done, 6, seed=5))
    np.testing.assert_allclose(bootstrap(done, 6, seed=5, pool=WorkerPool(2)), draws[:6])
    assert not np.allclose(bootstrap(done, 6, seed=6), draws[:6])
    ratio = draws.std(axis=0) / np.sqrt(done.covariance.diagonal())
    assert 0.4 < np.median(ratio) < 2.5 and ratio.max() < 6.0, ratio
    told = estimates(done, draws)
    assert all(e.low <= e.high for e in told.values()) and list(told) == list(estimates(done))


# ---- the whole command's ground: evidence, background, replays --------------------


@cache
def joint_model() -> GreyBox:
    return fit_model(split_recordings(JOINT, [recorded(7, 15.0)], []))


def test_a_fit_reaches_the_noise_floor_on_what_it_has_not_seen():
    told = fit_json(joint_model(), 0)
    for channel, mae in told["mae"].items():
        assert mae["refitted"] < 1.35 * mae["noise_floor"] + 1e-12, channel
        assert mae["refitted"] < mae["data_sheet"], channel
    assert told["mae"]["angle_deg"]["data_sheet"] > 3.0 * told["mae"]["angle_deg"]["refitted"]
    assert {p["word"] for p in told["parameters"].values()} <= {"settled", "weak", "silent"}
    assert all(0.0 <= b["pull"] < 3.0 for b in told["background"].values())


LIGHT, HEAVY = {"inertia_kg_m2": 0.02}, {"inertia_kg_m2": 0.0896}


def two_arms(folder: Path, stated: tuple[Any, Any] = (None, None)) -> list[Recording]:
    """Recordings of two arms of different known inertia; stated: what their files say of it."""
    return [
        record(folder / f"{seed}.csv", 6.0, seed=seed, known=known, stated=said)
        for seed, known, said in zip((3, 4), (LIGHT, HEAVY), stated, strict=True)
    ]


def test_names_and_order_of_recordings_do_not_matter(tmp_path):
    arms, renamed = two_arms(tmp_path), []
    for number, r in enumerate(arms[::-1]):
        for suffix in (".csv", ".toml"):
            (tmp_path / f"a{number}{suffix}").write_bytes(r.path.with_suffix(suffix).read_bytes())
        renamed.append(read_recording(tmp_path / f"a{number}.csv"))
    one, other = (fit_model(split_recordings(JOINT, given, [])) for given in (arms, renamed))
    np.testing.assert_array_equal(one.fit.p, other.fit.p)
    assert fit_json(one, 0)["mae"] == fit_json(other, 0)["mae"]


# ---- what a recording knows --------------------


def test_known_parameters_are_held_and_not_reported(tmp_path):
    stated = {**KNOWN, "viscous_n_m_s": 0.08, "scale": 1.1}
    done = fit_robustly(problem_of(JOINT, record(tmp_path / "rec.csv", 8.0, stated=stated)))
    a = done.problem.assembly
    assert {"viscous_n_m_s", "scale", "inertia_kg_m2"}.isdisjoint(by_name(estimates(done)))
    own = Runner(a, done.problem.tracks[0], done.stepping).parameters(done.p)
    assert (own[a.index_of("viscous_n_m_s")], own[a.index_of("scale")]) == (0.08, 1.1)
    assert own[a.index_of("inertia_kg_m2")] == 0.0896


def test_two_recordings_with_their_own_known_inertia(tmp_path):
    right = fit_robustly(problem_of(JOINT, *two_arms(tmp_path)))
    found = by_name(estimates(right))
    assert sum(e.low <= SPECIMEN[n] <= e.high for n, e in found.items()) >= 7
    wrong = fit_robustly(problem_of(JOINT, *two_arms(tmp_path, (HEAVY, LIGHT))))
    rms = [np.sqrt(np.mean(np.concatenate(f.residuals) ** 2, axis=0)) for f in (right, wrong)]
    assert (rms[1] / rms[0]).max() > 2.0


def test_a_parameter_known_to_one_recording_is_fitted_on_the_other(tmp_path):
    tight = {**KNOWN, "viscous_n_m_s": 0.3}
    hidden = {k: v for k, v in SPECIMEN.items() if k != "viscous_n_m_s"}
    knows = record(tmp_path / "knows.csv", 6.0, seed=3, known=tight, hidden=hidden)
    open_ = record(tmp_path / "open.csv", 6.0, seed=4)
    done = fit_robustly(problem_of(JOINT, knows, open_))
    found = by_name(estimates(done))["viscous_n_m_s"]
    assert found.low <= 0.08 <= found.high < 0.2


# ---- a small rig: silence, bounds, failure --------------------


class Cart(Rig):
    """A sprung mass with a brake that is rarely pulled."""

    name = "sprung"
    inputs = {"force_n": "N", "brake": ""}
    optional = {"brake": 0.0}
    outputs = {"position_m": "m"}
    ports = {"force": Port("motion", "N", ("velocity", "position")), "gauge": Port("reading", "m")}
    states = (State("position", "m"), State("velocity", "m/s"))
    parameters = (
        Parameter("mass", 1.0, 0.1, 10.0, "kg", spread=1.5, log=True, source="test"),
        Parameter("stiffness", 60.0, 10.0, 100.0, "N/m", spread=20.0, source="test"),
        Parameter("damping", 3.0, 0.0, 6.0, "N s/m", spread=1.5, source="test"),
        Parameter("grip", 5.0, 0.0, 20.0, "N s/m", spread=2.0, source="test"),
    )
    noise = {"position_m": 0.002}
    period_s = 0.01

    def rates(self, x, u, p, port):
        force = u.force_n - p.stiffness * x.position - (p.damping + p.grip * u.brake) * x.velocity
        force = port("force", force, velocity=x.velocity, position=x.position)
        return {"position": x.velocity, "velocity": force / p.mass}

    def measure(self, x, u, p, port):
        return {"position_m": port("gauge", x.position)}


def cart_record(
    folder: Path, *, seed: int = 0, period_s: float = 0.01, **truth: float
) -> Recording:
    a = Assembly(Cart())
    n = round(12.0 / period_s)
    random = np.random.default_rng(seed)
    columns = {"force_n": np.repeat(random.uniform(-10, 10, n // 40 + 1), 40)[:n]}
    path = folder / f"cart-{seed}-{period_s:g}.csv"
    write_recording(path, np.arange(n) * period_s, columns)
    made = virtual_recording(a, read_recording(path), a.values(truth), seed=seed)
    write_recording(path, np.arange(n) * period_s, made)
    return read_recording(path)


TRUTH = {"mass_kg": 1.3, "stiffness_n_per_m": 70.0, "damping_n_s_per_m": 2.0}


def cart_estimates(rig: Rig, *recordings: Recording) -> dict[str, Estimate]:
    return by_name(estimates(fit_robustly(problem_of(rig, *recordings))))


def test_a_parameter_the_data_are_silent_about_keeps_its_prior(tmp_path):
    found = cart_estimates(Cart(), cart_record(tmp_path, **TRUTH))
    grip = found["grip_n_s_per_m"]
    assert (grip.word, grip.at_bound) == ("silent", None)
    assert grip.value == pytest.approx(5.0, abs=1e-6) and grip.strain < 1e-6
    assert (grip.low, grip.high) == pytest.approx((5.0 - 1.96 * 2.0, 5.0 + 1.96 * 2.0), abs=1e-3)
    for name, value in TRUTH.items():
        assert found[name].word == "settled" and found[name].value == pytest.approx(value, rel=0.03)


def test_two_sampling_periods_in_one_fit(tmp_path):
    slow, fast = (
        cart_record(tmp_path, seed=1, period_s=0.02, **TRUTH),
        cart_record(tmp_path, seed=2, **TRUTH),
    )
    found = cart_estimates(Cart(), fast, slow)
    for name, value in TRUTH.items():
        assert found[name].value == pytest.approx(value, rel=0.03)


def test_a_parameter_at_its_bound_is_said(tmp_path):
    """The specimen is stiffer than the data sheet's bounds allow."""
    soft = Cart()
    soft.parameters = tuple(
        replace(q, high=65.0) if q.name == "stiffness" else q for q in Cart.parameters
    )  # type: ignore[misc]
    found = cart_estimates(soft, cart_record(tmp_path, **TRUTH))
    e = found["stiffness_n_per_m"]
    assert (e.at_bound, e.value) == ("high", pytest.approx(65.0)) and e.high <= 65.0 + 1e-9
    assert found["damping_n_s_per_m"].at_bound is None


def test_no_convergence_is_a_value_with_a_reason(tmp_path):
    problem = problem_of(Cart(), cart_record(tmp_path, **TRUTH))
    short = fit(problem, iterations=1, tolerance=1e-12)
    assert not short.converged and short.why == "iterations used up" and np.isfinite(short.cost)
    p, place = problem.assembly.values(), problem.assembly.index_of("stiffness_n_per_m")
    p[place] = -1e7  # would run away within a window
    lost = fit(problem, FitStart(p=p, stepping=Stepping(1)))
    assert lost.iterations > 0 and lost.p[place] >= 10.0, "clipped into its bounds first"


@pytest.mark.parametrize("many", [24, 0])
def test_a_fit_whose_cost_falls_fast_is_not_cut_off(tmp_path, monkeypatch, many):
    """Else the right model would be judged half fitted. many: 0 makes rejected steps cheap."""
    monkeypatch.setattr("pamid.estimation.multiple_shooting.MANY_UNKNOWNS", many)
    problem = problem_of(Cart(), cart_record(tmp_path, **TRUTH))
    p, place = problem.assembly.values(), problem.assembly.index_of("damping_n_s_per_m")
    p[place] *= 20.0
    whole, short = fit(problem, FitStart(p=p)), fit(problem, FitStart(p=p), iterations=2)
    probe = fit(problem, FitStart(p=p), iterations=2, probe=True)
    assert short.iterations > 2 and short.cost < 1.1 * whole.cost < probe.cost


class Runaway(Cart):
    """Unstable at its data sheet: an inverted pendulum's exponential, or a pole within a
    millisecond."""

    name = "runaway"

    def __init__(self, pole: bool) -> None:
        self.pole = pole

    def rates(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Any]:
        push = 1e6 * (1.0 + x.position * x.position) if self.pole else 5e4 * x.position + u.force_n
        force = port("force", push, velocity=x.velocity, position=x.position)
        return {"position": x.velocity, "velocity": force / p.mass}


@pytest.mark.parametrize("pole", [False, True])
def test_a_model_that_blows_up_is_an_outcome(pole, tmp_path):
    done = fit_robustly(problem_of(Runaway(pole), cart_record(tmp_path, **TRUTH)))
    assert not done.converged and "unstable" in done.why and done.cost == np.inf
    assert np.isfinite(done.p).all()
