"""Experiments of a rig with several joints: what is sent, what the virtual arm does with it, and
what a fit makes of it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from cli import frame
from pamid.base.errors import DataError
from pamid.excitation.aprbs import aprbs
from pamid.excitation.experiments import MENU, Bench, menu, odd_multisine
from pamid.model.registry import rig_named
from pamid.planning.next_experiment import bench_of
from pamid.recording.recording import Recording, read_recording, write_recording
from pamid.rigs.muscle_experiments import EXPERIMENTS, PULSES_S, muscle_pulses
from pamid.simulation.data_split import split_recordings

Array = NDArray[np.float64]
Command = Callable[..., dict[str, Any]]

PERIOD = 0.003
TRUTH = ("--set", "link_1_mass_kg=2.6", "--set", "viscous_2_n_m_s=0.08")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("arm")


def generate(path: Path, *more: str) -> int:
    return frame.run(
        ["generate-aprbs", "--rig", "two-link", *more, "--output", str(path), "--overwrite"]
    )


def simulated(path: Path, *more: str) -> Recording:
    """What the virtual arm records of the excitation at `path`."""
    output = path.with_name(f"{path.stem}-recorded.csv")
    assert (
        frame.run(
            ["simulate", "--excitation", str(path), *more, "--output", str(output), "--overwrite"]
        )
        == 0
    )
    return read_recording(output)


def noted(path: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(path.with_suffix(".json").read_text())
    return found


# ---- random steps --------------------


def test_every_joint_gets_steps_of_its_own(folder: Path) -> None:
    path = folder / "steps.csv"
    assert (
        generate(path, "--duration", "60", "--seed", "4", "--amplitude", "reference_2_deg=25") == 0
    )
    made, about = read_recording(path), noted(path)
    assert list(made.columns) == ["reference_1_deg", "reference_2_deg"]
    one, two = made.columns.values()
    np.testing.assert_allclose(one, aprbs(60.0, PERIOD, 20.0, seed=4), rtol=1e-8)
    assert abs(np.corrcoef(one, two)[0, 1]) < 0.3
    assert len(np.intersect1d(np.flatnonzero(np.diff(one)), np.flatnonzero(np.diff(two)))) < 3
    assert [c["range"] for c in about["columns"]] == [[-20.0, 20.0], [-25.0, 25.0]]
    assert all(c["coverage"]["visited"] > 0.9 for c in about["columns"]) and "column" not in about
    assert not path.with_suffix(".toml").exists()
    again = folder / "again.csv"
    assert (
        generate(again, "--duration", "60", "--seed", "5", "--amplitude", "reference_2_deg=25") == 0
    )
    assert not any(
        np.array_equal(made.columns[c], read_recording(again).columns[c]) for c in made.columns
    )


def test_the_contract_s_call_is_what_it_was(folder: Path) -> None:
    path = folder / "one.csv"
    assert (
        frame.run(
            [
                "generate-aprbs",
                "--rig",
                "one-dof",
                "--duration",
                "200",
                "--amplitude",
                "40",
                "--hold",
                "0.4",
                "1.6",
                "--seed",
                "1",
                "--output",
                str(path),
            ]
        )
        == 0
    )
    np.testing.assert_allclose(
        read_recording(path).columns["reference_deg"], aprbs(200.0, PERIOD, 40.0, seed=1), rtol=1e-8
    )
    assert list(noted(path)) == [
        "schema",
        "generator",
        "file",
        "sha256",
        "rig",
        "signal",
        "loop",
        "column",
        "unit",
        "range",
        "hold_s",
        "levels",
        "rate_limit_per_s",
        "seed",
        "sampling_period_s",
        "samples",
        "coverage",
    ]


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (("--loop", "open", "--amplitude", "command_2=1.1"), "command_2 lies within +-1"),
        (("--amplitude", "referenc_2_deg=3"), "Did you mean 'reference_2_deg'?"),
        (("--amplitude", "wide"), "'wide' is no number"),
        (("--muscle", "11"), "--muscle says nothing to --experiment aprbs"),
        (("--experiment", "gravity-test", "--loop", "open"), "--loop says nothing"),
        (("--experiment", "gravity-test", "--clamped", "3"), "Did you mean 'clamped_2'?"),
        (
            ("--experiment", "gravity-test", "--release", "0", "190"),
            "initial_angle_2_deg = 190 lies outside",
        ),
        (("--experiment", "gravity-test", "--payload", "-1"), "payload_kg = -1 lies outside"),
        (("--experiment", "gravity-test", "--duration", "-1"), "no recording"),
        (("--experiment", "valve-pulses", "--muscle", "13"), "11, 12, 21, 22"),
        (("--experiment", "valve-pulses", "--level", "1.5"), "(0, 1]"),
        (("--experiment", "valve-pulses", "--period", "0.05"), "shortest pulse"),
        (("--experiment", "gravity-test", "--rig", "one-dof"), "horizontal plane"),
        (("--experiment", "valve-pulses", "--rig", "data/rigs/cart.py"), "has no muscle."),
    ],
)
def test_requests_without_sense_are_refused(
    more: tuple[str, ...], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert generate(tmp_path / "x.csv", *more) == 2
    assert words in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


# ---- swings --------------------


def crossings_hz(angle: Array) -> float:
    """Frequency of a decaying swing from the times between its zero crossings."""
    at = np.flatnonzero(np.diff(np.sign(angle)))
    return float((len(at) - 1) / (2.0 * PERIOD * (at[-1] - at[0])))


def swing(folder: Path, *more: str) -> Recording:
    path = folder / "swing.csv"
    assert generate(path, "--experiment", "gravity-test", "--duration", "8", *more) == 0
    return simulated(path, "--noise", "none")


def test_a_clamped_arm_swings_as_a_pendulum(folder: Path) -> None:
    """Link 2 alone: f = sqrt(m g c/(I + m c^2))/2pi = 1.08 Hz, lower by its damping and for wide
    swings."""
    made = swing(folder, "--release", "0", "10", "--clamped", "1")
    assert np.ptp(made.signal("angle_1_deg")) == 0.0
    assert made.signal("angle_2_deg")[0] == pytest.approx(10.0, abs=0.01)
    plain = np.sqrt(0.70 * 9.81 * 0.13 / (0.0075 + 0.70 * 0.13**2)) / (2.0 * np.pi)
    assert crossings_hz(made.signal("angle_2_deg")[:1200]) == pytest.approx(plain, rel=0.05)
    heavier = swing(folder, "--release", "0", "10", "--clamped", "1", "--payload", "0.5")
    loaded = np.sqrt((0.70 * 0.13 + 0.5 * 0.3) * 9.81 / (0.0075 + 0.70 * 0.13**2 + 0.5 * 0.09)) / (
        2.0 * np.pi
    )
    assert crossings_hz(heavier.signal("angle_2_deg")[:1200]) == pytest.approx(loaded, rel=0.05)


def test_what_the_excitation_knows_is_passed_on(folder: Path) -> None:
    made = swing(folder, "--payload", "0.25")
    assert made.loop == "open" and made.rig == "two-link"
    assert made.known == {
        "vents_open": 1.0,
        "initial_pressure_kpa": 0.0,
        "initial_angle_1_deg": 30.0,
        "initial_angle_2_deg": 40.0,
        "payload_kg": 0.25,
    }
    assert [made.signal(f"angle_{j}_deg")[0] for j in "12"] == pytest.approx([30.0, 40.0], abs=0.01)
    assert not any(made.has(f"command_{j}") for j in "12")
    other = simulated(folder / "swing.csv", "--noise", "none", "--known", "initial_angle_1_deg=-20")
    assert other.known == {**made.known, "initial_angle_1_deg": -20.0}
    assert other.signal("angle_1_deg")[0] == pytest.approx(-20.0, abs=0.01)


# ---- pulses --------------------


@pytest.mark.parametrize(
    ("rig", "muscles"), [("one-dof", ("1", "2")), ("two-link", ("11", "12", "21", "22"))]
)
def test_each_muscle_is_vented_in_its_turn(
    rig: str, muscles: tuple[str, ...], folder: Path
) -> None:
    path = folder / "pulses.csv"
    assert generate(path, "--rig", rig, "--experiment", "valve-pulses", "--level", "0.5") == 0
    made = simulated(path, "--noise", "none")
    turn = round(15.0 / PERIOD)
    assert len(made) == len(muscles) * turn and noted(path)["muscles"] == list(muscles)
    for k, muscle in enumerate(muscles):
        first = slice(k * turn, k * turn + round(0.43 / PERIOD))  # up to the end of the first pulse
        fallen = {
            m: float(np.ptp(np.minimum.accumulate(made.signal(f"pressure_{m}_kpa")[first])))
            for m in muscles
        }
        assert max(fallen, key=lambda m: fallen[m]) == muscle and fallen[muscle] > 5.0, fallen
    for name, column in read_recording(path).columns.items():
        edges = np.flatnonzero(np.diff(column))
        lengths = np.diff(edges)[::2][:10] * PERIOD
        np.testing.assert_allclose(lengths, np.repeat(PULSES_S, 2), atol=PERIOD, err_msg=name)
        assert set(np.unique(column)) == {-0.5, 0.0, 0.5}


def test_the_muscles_asked_for_and_no_other(folder: Path) -> None:
    path = folder / "some.csv"
    assert generate(path, "--experiment", "valve-pulses", "--muscle", "22") == 0
    made = read_recording(path)
    assert not made.signal("command_1").any() and len(made) == round(15.0 / PERIOD)
    both = muscle_pulses(rig_named("two-link"), ("22", "21"), 1.0, PERIOD)["command_2"]
    np.testing.assert_array_equal(both[: len(made)], made.signal("command_2"))
    np.testing.assert_array_equal(both[len(made) :], -made.signal("command_2"))


# ---- loops --------------------


def test_every_loop_sees_the_noise_of_its_own_reading(folder: Path) -> None:
    """The commands are what two PD controllers make of the references and of the angles as they
    were recorded."""
    path = folder / "loops.csv"
    assert generate(path, "--duration", "6", "--seed", "2") == 0
    made = simulated(path, "--rig", "two-link", "--seed", "3")
    c = made.controller
    assert made.loop == "closed"
    for j in "12":
        error = made.signal(f"reference_{j}_deg") - made.signal(f"angle_{j}_deg")
        slope, sent = 0.0, np.empty(len(made))
        for k, now in enumerate(error):
            raw = (now - error[k - 1]) / PERIOD if k else 0.0
            slope += (raw - slope) * PERIOD / (c["derivative_filter_s"] + PERIOD) if k else 0.0
            sent[k] = np.clip(
                c["kp_per_deg"] * now + c["kd_s_per_deg"] * slope,
                -c["command_limit"],
                c["command_limit"],
            )
        np.testing.assert_allclose(sent, made.signal(f"command_{j}"), atol=1e-5)


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        (("reference_1_deg",), "has reference_1_deg, but not reference_2_deg"),
        (("command_2",), "has command_2, but not command_1"),
        (("reference_1_deg", "command_2"), "has reference_1_deg and command_2, but not command_1"),
    ],
)
def test_half_a_loop_is_refused(
    columns: tuple[str, ...], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "half.csv"
    write_recording(path, PERIOD * np.arange(600), dict.fromkeys(columns, np.zeros(600)))
    assert (
        frame.run(
            [
                "simulate",
                "--rig",
                "two-link",
                "--excitation",
                str(path),
                "--output",
                str(tmp_path / "rec.csv"),
            ]
        )
        == 3
    )
    assert words in capsys.readouterr().err and not (tmp_path / "rec.csv").exists()


# ---- evidence and fit --------------------


@pytest.fixture(scope="module")
def recorded(folder: Path) -> tuple[Path, Path]:
    """A swing of both links, and pulses on one muscle of each joint."""
    free, pulses = folder / "free.csv", folder / "two.csv"
    assert generate(free, "--experiment", "gravity-test", "--duration", "6") == 0
    assert generate(pulses, "--experiment", "valve-pulses", "--muscle", "12", "--muscle", "21") == 0
    return simulated(free, *TRUTH, "--seed", "1").path, simulated(
        pulses, *TRUTH, "--seed", "2"
    ).path


@pytest.mark.slow
def test_a_swing_and_pulses_fit_together(
    recorded: tuple[Path, Path], folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for path in recorded:
        assert frame.run(["check", str(path)]) == 0, capsys.readouterr().out
    run = folder / "run"
    assert (
        frame.run(
            ["fit", *map(str, recorded), "--rig", "two-link", "--output", str(run), "--overwrite"]
        )
        == 0
    )
    found = json.loads((run / "fit.json").read_text())["parameters"]
    assert found["viscous_2_n_m_s"]["value"] == pytest.approx(0.08, abs=0.002)
    mass_1, centre_1, mass_2 = (
        found[f"link_{k}"]["value"] for k in ("1_mass_kg", "1_centre_m", "2_mass_kg")
    )
    assert mass_1 * centre_1 + 0.4 * mass_2 == pytest.approx(2.6 * 0.20 + 0.70 * 0.40, rel=0.01)
    header = (run / "residual.csv").read_text().split("\n", 1)[0].split(",")
    assert len(set(header)) == len(header) and not {"command_1", "external_torque_1_nm"} & set(
        header
    )


def test_a_channel_may_rest_while_another_moves(folder: Path) -> None:
    made = swing(folder, "--release", "0", "30", "--clamped", "1")
    evidence = split_recordings(rig_named("two-link"), [made], [])
    assert "angle_2_deg" in evidence.channels and "angle_1_deg" not in evidence.channels
    assert np.isfinite(evidence.noise).all() and (evidence.noise > 1e-12).all()
    free = swing(folder)
    assert "angle_1_deg" in split_recordings(rig_named("two-link"), [made, free], []).channels
    assert np.isfinite(split_recordings(rig_named("two-link"), [made, free], []).jump).all()


def test_nothing_moves_nothing_is_learnt(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    still = swing(folder, "--release", "0", "0", "--clamped", "1", "--clamped", "2")
    with pytest.raises(DataError, match="constant") as refused:
        split_recordings(rig_named("two-link"), [still], [])
    assert refused.value.code == "not-excited"
    assert (
        frame.run(["check", str(still.path)]) == 3
        and "nothing can be learnt" in capsys.readouterr().out
    )


def test_a_bench_without_anything_to_drive_is_offered_what_needs_no_drive() -> None:
    assert [e.name for e in menu(Bench(rig_named("two-link"), {}, PERIOD))] == ["gravity-test"]


# ---- the menu --------------------


def bench() -> Bench:
    rig = rig_named("two-link")
    return Bench(
        rig,
        {"reference_1_deg": (0.0, 20.0), "reference_2_deg": (5.0, 30.0)},
        PERIOD,
        tuple(q.command for q in rig.loops),
        ("external_torque_1_nm", "external_torque_2_nm"),
    )


def test_the_arm_is_offered_everything() -> None:
    assert menu(bench()) == [*EXPERIMENTS, *MENU]
    for e in (*EXPERIMENTS, *MENU):
        columns = e.signals(bench())
        assert len({len(v) for v in columns.values()}) == 1, e.name
        assert {"reference_1_deg", "reference_2_deg"} <= set(columns) or not {
            "reference_1_deg",
            "reference_2_deg",
        } & set(columns)


@pytest.mark.parametrize(
    "name", ["torque-loops-two-pressures", "quick-release", "valve-pulses", "duty-staircase"]
)
def test_joints_take_turns(name: str) -> None:
    e = next(e for e in EXPERIMENTS if e.name == name)
    columns = e.signals(bench())
    half = len(next(iter(columns.values()))) // 2
    kind = "external_torque_{}_nm" if e.pushed else "command_{}"
    one, two = (columns[kind.format(j)] for j in "12")
    assert one[:half].any() and not one[half:].any() and not two[:half].any()
    np.testing.assert_array_equal(one[:half], two[half:])
    assert e.minutes_on(bench()) == 2.0 * e.minutes
    if e.pushed:
        assert not any(columns[f"command_{j}"].any() for j in "12")


def test_driven_joints_do_not_move_alike() -> None:
    for passes in (1, 2, 4):
        one, two = (
            Bench(
                rig_named("two-link"),
                {"reference_1_deg": (0.0, 1.0), "reference_2_deg": (0.0, 1.0)},
                PERIOD,
                passes=passes,
            )
            .driving(odd_multisine)
            .values()
        )
        assert abs(np.corrcoef(one, two)[0, 1]) < 0.5


def test_the_bench_is_that_of_the_commanded_recording(recorded: tuple[Path, Path]) -> None:
    """What only held for the swing, open vents before all, is not carried over into what is
    proposed."""
    swung, pulsed = map(read_recording, recorded)
    rig = rig_named("two-link")
    for recordings in ([swung, pulsed], [pulsed, swung], [swung]):
        b = bench_of(split_recordings(rig, recordings, []))
        assert b.known == {} and b.command == ("command_1", "command_2")
        assert menu(b) == [*EXPERIMENTS, *MENU]
        assert list(b.driven) == ["reference_1_deg", "reference_2_deg"] and all(
            h > 1.0 for _, h in b.driven.values()
        )
