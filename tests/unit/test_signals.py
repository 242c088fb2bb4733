"""Signals beside the APRBS: what makes each of them, limits, several columns, and what a signal is
said to cover."""

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pamid_cli import frame

from pamid.base.errors import UsageError
from pamid.recording.recording import read_recording
from pamid.simulation.excitation.waveforms import (
    SIGNAL_SETTINGS,
    draw,
    nested_loops,
    plan_for,
)

#: sha256 of what these calls wrote before there was another signal than the APRBS
BEFORE = {
    "--rig one-dof --duration 200 --amplitude 40 --hold 0.4 1.6 --seed 1": "c972a3e2e4e1075c45e350338b62bc25b38dde561eace5dd62466f96c39ef5b2",  # noqa: E501
    "--rig two-link --duration 60 --seed 4 --amplitude reference_2_deg=25": "ea0b7ce9547ee6b64b17ae5bcc6f4184b34fa8c499cec77cb43232635961feb1",  # noqa: E501
    "--loop open --duration 40 --levels 5 --rate-limit 4 --offset 0.1 --seed 3": "92b8fae030b734ced38a79016c42d810ded2fd1e785df294e4eb6218adc31a9f",  # noqa: E501
    "--column force_n --duration 30 --amplitude 3 --hold 0.2 0.8 --seed 1": "24884e103db819432f33c701ad970bc44e8ef7309b25569dd8532244011dceaa",  # noqa: E501
    "--experiment valve-pulses --rig two-link": "ebbc4767dafc89aaf64e576fefe1fbba2f10dc23d1d0926906315173e89cfe77",  # noqa: E501
    "--experiment gravity-test --rig two-link --release 60 0 --clamped 1": "92bdedfefe6f7f80d80f5f57ee5417a38d4b18b626122632a097b3ce9b21ba38",  # noqa: E501
}

PERIOD = 0.003


def generate(path: Path, *more: str) -> int:
    return frame.run(["generate-aprbs", *more, "--output", str(path)])


def samples_of(signal: str, amplitude: float, **settings: Any) -> np.ndarray:
    """One column of this signal."""
    return draw(plan_for(signal, PERIOD, **settings), {"x": amplitude})["x"].samples


def noted(path: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(path.with_suffix(".json").read_text())
    return found


# ---- each signal --------------------


@pytest.mark.parametrize("order", [4, 7, 10])
def test_a_prbs_is_a_sequence_of_greatest_length(order):
    """Every pattern of `order` bits but one occurs once, and the sequence is white: correlation
    -1/n at every lag."""
    clock, length = 5, 2**order - 1
    duration_s, hold_s = (2 * length + 1) * clock * PERIOD, (clock * PERIOD, order * clock * PERIOD)
    signal = samples_of("prbs", 3.0, duration_s=duration_s, hold_s=hold_s, seed=2)
    assert not signal[:clock].any() and set(np.unique(signal[clock:])) == {-3.0, 3.0}
    bits = np.sign(signal[clock::clock])
    assert bits.size == 2 * length and np.array_equal(bits[:length], bits[length:])
    once = bits[:length]
    assert len({tuple(np.roll(once, -k)[:order]) for k in range(length)}) == length
    spectrum = np.abs(np.fft.fft(once)) ** 2
    np.testing.assert_allclose(np.fft.ifft(spectrum).real[1:], -1.0, atol=1e-6)
    assert abs(once.sum()) == 1.0


def test_the_multisine_has_odd_lines_in_its_band_and_no_others():
    signal = samples_of("multisine", 4.0, duration_s=60.0, band_hz=(0.5, 5.0), periods=3, seed=1)
    one = 20000 // 3
    assert signal.shape == (20000,) and np.abs(signal).max() == pytest.approx(4.0)
    np.testing.assert_allclose(signal[:one], signal[one : 2 * one], atol=1e-12)
    heights = np.abs(np.fft.rfft(signal[:one])) / one
    lines = np.flatnonzero(heights > 1e-9)
    base = 1.0 / (one * PERIOD)
    assert (lines % 2 == 1).all() and np.ptp(heights[lines]) < 1e-9
    assert (
        lines[0] * base >= 0.5
        and lines[-1] * base <= 5.0
        and lines.size == pytest.approx(4.5 / (2 * base), abs=1)
    )
    assert abs(signal[0]) < 0.05


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("duration", "band"), [(200.0, (0.1, 10.0)), (40.0, (0.1, 5.0))])
def test_crest_optimisation_reaches_1_5(seed, duration, band):
    signal = samples_of("multisine", 1.0, duration_s=duration, band_hz=band, periods=2, seed=seed)
    one = signal[: round(duration / PERIOD) // 2]
    assert np.abs(one).max() / np.sqrt(np.mean(one**2)) <= 1.5
    drawn = np.random.default_rng(seed).uniform(0, 2 * np.pi, 200)  # and without it: about 3
    plain = np.sin(2 * np.pi * np.outer(np.arange(4000) / 4000, np.arange(1, 401, 2)) + drawn).sum(
        axis=1
    )
    assert np.abs(plain).max() / np.sqrt(np.mean(plain**2)) > 2.3


@pytest.mark.parametrize("sweep", ["log", "linear"])
def test_a_chirp_climbs_as_asked_and_ends_where_it_began(sweep):
    signal = samples_of("chirp", 2.0, duration_s=60.0, band_hz=(0.2, 6.0), sweep=sweep, offset=1.0)
    assert (
        signal[0] == pytest.approx(1.0) and abs(signal[-1] - 1.0) < 2.0 * 2 * np.pi * 6.0 * PERIOD
    )
    assert signal.max() == pytest.approx(3.0, abs=1e-3) and signal.min() == pytest.approx(
        -1.0, abs=1e-3
    )
    rising = np.flatnonzero((signal[:-1] < 1.0) & (signal[1:] >= 1.0)) * PERIOD
    frequency = 1.0 / np.diff(rising)
    at = 0.5 * (rising[1:] + rising[:-1]) / 60.0
    asked = 0.2 * 30.0**at if sweep == "log" else 0.2 + 5.8 * at
    np.testing.assert_allclose(frequency, asked, rtol=0.06)
    assert frequency[-1] > 5.5


def test_torque_loops_return_and_hold_a_smaller_loop():
    t = PERIOD * np.arange(round(14.0 / PERIOD), dtype=np.float64)
    wave = nested_loops(t)
    assert (
        wave[0] == 0.0
        and abs(wave[-1]) < 0.01
        and wave.max() == 1.0
        and wave.min() == pytest.approx(-1.0, abs=2e-3)
    )
    assert np.abs(np.diff(wave)).max() / PERIOD == pytest.approx(0.5)


# ---- limits --------------------


@pytest.mark.parametrize("signal", SIGNAL_SETTINGS)
def test_amplitude_and_rate_are_kept_by_every_signal(signal):
    band: dict[str, Any] = {"band_hz": (0.1, 1.0)} if "band_hz" in SIGNAL_SETTINGS[signal] else {}
    plan = plan_for(signal, PERIOD, rate_limit=200.0, **band)
    sent = draw(plan, {"a": 20.0, "b": 5.0})
    assert len({s.samples.size for s in sent.values()}) == 1
    for name, one in sent.items():
        assert np.abs(one.samples).max() <= {"a": 20.0, "b": 5.0}[name] * (1 + 1e-12)
        assert np.abs(np.diff(one.samples)).max() <= 200.0 * PERIOD * (1 + 1e-9)
        assert np.isfinite(one.samples).all()


@pytest.mark.parametrize("signal", ["multisine", "chirp"])
def test_a_smooth_signal_is_never_bent_by_the_rate_limit(signal):
    with pytest.raises(UsageError, match="rate limit is 10") as refused:
        draw(
            plan_for(signal, PERIOD, rate_limit=10.0, band_hz=(0.1, 2.0), duration_s=30.0),
            {"a": 20.0},
        )
    most = float(refused.value.hint.split("at most ")[1].split(",")[0])
    draw(
        plan_for(signal, PERIOD, rate_limit=10.0, band_hz=(0.1, 2.0), duration_s=30.0),
        {"a": 0.99 * most},
    )


@pytest.mark.parametrize(
    ("signal", "wrong"),
    [
        ("prsb", {}),
        ("chirp", {"band_hz": (2.0, 1.0)}),
        ("chirp", {"band_hz": (1.0, 200.0)}),
        ("chirp", {"duration_s": 0.05}),
        ("multisine", {"band_hz": (0.101, 0.1011)}),
        ("multisine", {"periods": 0}),
        ("staircase", {"levels": 1}),
        ("steps", {"duration_s": 3.0}),
    ],
)
def test_requests_without_sense_are_refused(signal, wrong):
    with pytest.raises(UsageError):
        draw(plan_for(signal, PERIOD, **wrong), {"a": 1.0})


# ---- several columns --------------------


@pytest.mark.parametrize("signal", SIGNAL_SETTINGS)
def test_columns_are_sent_apart_or_unlike(signal):
    sent = draw(plan_for(signal, PERIOD, seed=5), {"a": 1.0, "b": 1.0, "c": 1.0})
    a, b, c = (one.samples for one in sent.values())
    assert max(abs(np.corrcoef(x, y)[0, 1]) for x, y in ((a, b), (a, c), (b, c))) < 0.15
    if signal in ("aprbs", "prbs", "multisine"):
        alone = draw(plan_for(signal, PERIOD, seed=5), {"a": 1.0})["a"].samples
        assert np.array_equal(a, alone)
    else:
        active = [np.abs(np.diff(x)) > 1e-12 for x in (a, b, c)]
        assert not (active[0] & active[1]).any() and not (active[1] & active[2]).any()
        assert [one.turn.start for one in sent.values()] == [0, a.size // 3, 2 * (a.size // 3)]


# ---- the command --------------------


@pytest.mark.parametrize("signal", [name for name in SIGNAL_SETTINGS if name != "aprbs"])
@pytest.mark.parametrize(
    "where",
    [
        ("--rig", "one-dof"),
        ("--rig", "two-link", "--loop", "open"),
        ("--rig", "data/rigs/cart.py", "--amplitude", "3"),
    ],
    ids=["joint", "arm", "cart"],
)
def test_every_signal_for_every_rig(signal, where, tmp_path, capsys):
    path = tmp_path / "sent.csv"
    loops = signal == "torque-loops"
    if loops:
        where = where[:2]
    length = ("--duration", "20") if "duration_s" in SIGNAL_SETTINGS[signal] and not loops else ()
    if loops and where[1].endswith(".py"):
        assert (
            generate(path, "--signal", signal, *where) == 2 and "force_n" in capsys.readouterr().err
        )
        return
    assert generate(path, "--signal", signal, *where, *length) == 0
    made, about = read_recording(path), noted(path)
    two, cart = where[1] == "two-link", where[1].endswith(".py")
    kind = (
        "external_torque{}_nm"
        if loops
        else "command{}"
        if two
        else "force_n"
        if cart
        else "reference{}_deg"
    )
    names = [kind.format(j) for j in (("_1", "_2") if two else ("",))]
    assert [n for n in made.columns if np.ptp(made.columns[n]) > 0] == names
    assert about["signal"] == signal and about["schema"] == "pamid.excitation/1"
    each = about.get("columns", [about])
    assert [c["column"] for c in each] == names
    for c in each:
        assert np.abs(made.columns[c["column"]]).max() <= c["range"][1] * (1 + 1e-8)
        assert c["coverage"]["sentences"] and c["coverage"]["changes"] is not None
    assert ("seed" in about) == (signal not in ("chirp", "torque-loops"))


@pytest.mark.parametrize("call", BEFORE)
def test_what_there_was_is_bit_for_bit_what_it_was(call, tmp_path):
    path = tmp_path / "as-ever.csv"
    assert generate(path, *call.split()) == 0
    assert hashlib.sha256(path.read_bytes()).hexdigest() == BEFORE[call] == noted(path)["sha256"]


def test_torque_loops_state_the_pressure_and_simulate(tmp_path):
    angles = {}
    for pressure in ("200", "500"):
        path, out = tmp_path / f"loops-{pressure}.csv", tmp_path / f"rec-{pressure}.csv"
        assert generate(path, "--signal", "torque-loops", "--pressure", pressure) == 0
        assert (
            frame.run(
                ["simulate", "--excitation", str(path), "--noise", "none", "--output", str(out)]
            )
            == 0
        )
        made = read_recording(out)
        assert made.loop == "open" and made.known == {"initial_pressure_kpa": float(pressure)}
        assert made.signal("pressure_1_kpa")[0] == pytest.approx(float(pressure), abs=1.0)
        assert not made.signal("command").any()
        angles[pressure] = np.ptp(made.signal("angle_deg"))
    assert angles["200"] > 1.5 * angles["500"]  # a joint with less air is softer


def test_steps_alternate_and_rest_before_and_after():
    signal = samples_of("steps", 5.0, duration_s=40.0, hold_s=(1.0, 2.0), seed=3, offset=1.0)
    assert signal.shape == (13333,) and signal[0] == signal[-1] == 1.0
    edges = np.flatnonzero(np.diff(signal))
    held = signal[edges[:-1] + 1]
    np.testing.assert_array_equal(held, np.resize([6.0, -4.0], held.size))
    lengths = np.diff(edges)[:-1] * PERIOD
    assert lengths.min() >= 1.0 - PERIOD and lengths.max() <= 2.0 + PERIOD and np.ptp(lengths) > 0.5


def test_a_staircase_grows_by_one_factor_there_and_back():
    signal = samples_of("staircase", 0.3, levels=5, hold_s=(0.5, 0.5))
    held = signal[np.append(0, np.flatnonzero(np.diff(signal)) + 1)]
    assert held[0] == held[-1] == 0.0
    np.testing.assert_allclose(held[1:-1:2], -held[2:-1:2])
    np.testing.assert_allclose(held[1:-1:2], np.geomspace(0.02, 0.3, 5))
