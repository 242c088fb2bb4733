"""The quality card: nothing is claimed of good recordings, every planted defect is found, with its
name and place."""

import dataclasses
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from pamid_cli.frame import run
from virtual_recordings import virtual_recording

from pamid.base.arrays import Array
from pamid.intake.checks.findings import QualityIssue
from pamid.intake.checks.recording_quality import examine
from pamid.model import registry as library
from pamid.model.rig import Rig
from pamid.recording.recording import Recording, read_recording, write_recording
from pamid.simulation.excitation.aprbs import aprbs

Columns = dict[str, Array]

ROOT = Path(__file__).resolve().parents[2]
CART = str(ROOT / "data" / "rigs" / "cart.py")
EXAMPLE = ROOT / "data" / "example" / "joint.csv"
PERIOD = 0.003
P1, P2, ANGLE = "pressure_1_kpa", "pressure_2_kpa", "angle_deg"


@cache
def sent_as(name: str) -> tuple[Recording, Rig]:
    """The virtual recording of that entry of SENT, and its rig."""
    rig, sent, effects, noise = SENT[name]
    return virtual_recording(rig, sent, PERIOD, *effects, noise=noise), library.rig_named(rig)


def reference(seconds: float = 30.0, seed: int = 1) -> Array:
    return aprbs(seconds, PERIOD, 35.0, (0.4, 1.6), seed=seed)


@pytest.fixture(scope="module")
def joint() -> Recording:
    sent, true = {"reference_deg": reference()}, {"inertia_kg_m2": 0.09}
    made = virtual_recording("one-dof", sent, PERIOD, "coulomb-friction", true=true)
    return dataclasses.replace(made, known=true)


def changed(recording: Recording, **columns: Array) -> Recording:
    return dataclasses.replace(recording, columns={**recording.columns, **columns})


def only(issues: tuple[QualityIssue, ...], kind: str) -> QualityIssue:
    """The one issue there is, of this kind."""
    assert [i.kind for i in issues] == [kind], issues
    return issues[0]


# ---- good recordings --------------------

SENT: dict[str, tuple[str, Columns, tuple[str, ...], float]] = {
    "closed": ("one-dof", {"reference_deg": reference()}, ("stribeck-friction",), 1.0),
    "clean": ("one-dof", {"reference_deg": reference()}, ("maxwell-slip-hysteresis",), 0.0),
    "stop": ("one-dof", {"reference_deg": reference()}, ("end-stop", "valve-dead-band"), 1.0),
    "open": ("one-dof", {"command": aprbs(30.0, PERIOD, 0.8, (0.2, 0.8), seed=2)}, (), 1.0),
    "open-clean": ("one-dof", {"command": aprbs(30.0, PERIOD, 0.8, (0.2, 0.8), seed=2)}, (), 0.0),
    "arm": (
        "two-link",
        {f"reference_{k}_deg": 0.7 * reference(15.0, seed=k) for k in (1, 2)},
        ("coulomb-friction@joint_1",),
        1.0,
    ),
    "cart": (
        CART,
        {"force_n": aprbs(30.0, PERIOD, 5.0, (0.1, 0.8), seed=4)},
        ("coulomb-friction",),
        1.0,
    ),
}


#: recordings that are costly to examine, with the converter at which `make test` does so
COSTLY = {"clean": 12, "stop": 0, "example": 0}
GOOD = [
    pytest.param(name, bits, marks=[pytest.mark.slow] if COSTLY.get(name, bits) != bits else [])
    for name in [*SENT, "example"]
    for bits in (0, 12, 16)
]


@pytest.mark.parametrize(("name", "bits"), GOOD)
def test_nothing_is_claimed_of_a_good_recording(name, bits):
    if name == "example":
        recording, rig = read_recording(EXAMPLE), library.rig_named("one-dof")
    else:
        recording, rig = sent_as(name)
    if bits:
        steps = {
            c: float(np.abs(recording.columns[c]).max()) / 2 ** (bits - 1) for c in rig.outputs
        }
        converted = {c: rounded(recording.columns[c], step) for c, step in steps.items()}
        recording = changed(recording, **converted)
    assert examine(recording, rig) == ()
    assert examine(recording) == ()


# ---- planted defects --------------------


def held(values: Array, start: int, stop: int) -> Array:
    out = values.copy()
    out[start:stop] = out[start]
    return out


def ramp(values: Array, start: int, stop: int) -> Array:
    out = values.copy()
    out[start:stop] = np.linspace(out[start], out[stop - 1], stop - start)
    return out


def moved(values: Array, by: dict[int, float]) -> Array:
    out = values.copy()
    for place, much in by.items():
        out[place] += much
    return out


def rounded(values: Array, step: float) -> Array:
    return np.asarray(np.round(values / step) * step)


def noise_of(count: int, seed: int = 1) -> Array:
    return np.random.default_rng(seed).standard_normal(count)


DEFECTS: dict[str, tuple[str, Callable[[Array], Array], str, tuple[float, float] | None]] = {
    "clipped": (P2, lambda y: np.minimum(y, 540.0), "clipped", None),
    "clipped on an encoder": (ANGLE, lambda y: np.minimum(rounded(y, 0.09), 18.0), "clipped", None),
    "coarse": (P1, lambda y: rounded(y, 8.0), "coarse", None),
    "coarse before the logger": (
        P1,
        lambda y: rounded(y, 20.0) + 0.5 * noise_of(y.size, 4),
        "coarse",
        None,
    ),
    "dead": (P1, lambda y: np.full(y.size, 101.0), "dead", None),
    "unplugged": (P1, lambda y: 3.0 + noise_of(y.size), "dead", None),
    "frozen": (P1, lambda y: held(y, 4000, 4300), "frozen", (12.0, 12.9)),
    "bridged": (P1, lambda y: ramp(y, 5000, 5100), "bridged", (15.0, 15.3)),
    "spikes": (ANGLE, lambda y: moved(y, {2000: 15.0, 7000: -9.0}), "spikes", (6.0, 6.0)),
    "noisy": (ANGLE, lambda y: y + 8.0 * noise_of(y.size), "noisy", None),
    "slow": (P2, lambda y: y[np.arange(y.size) // 4 * 4], "sampled-slowly", None),
}


@pytest.mark.parametrize("defect", DEFECTS)
@pytest.mark.parametrize("with_rig", [False, True])
def test_a_planted_defect_is_found(joint, defect, with_rig):
    column, spoil, kind, window = DEFECTS[defect]
    spoilt = changed(joint, **{column: spoil(joint.columns[column])})
    issue = only(examine(spoilt, library.rig_named("one-dof") if with_rig else None), kind)
    certain = with_rig and defect == "dead"  # its model would move
    assert (
        issue.columns == (column,)
        and issue.severity == ("wrong" if certain else "advice")
        and issue.hint
    )
    if window is not None:
        assert issue.windows_s[0] == pytest.approx(window, abs=0.01)


@pytest.mark.parametrize(
    ("sent", "word"),
    [
        (np.where(np.arange(10000) > 5000, 30.0, 0.0), "1 step"),
        (0.02 * reference(), "2% of the usual range"),
        (np.concatenate([reference()[:3000], np.full(7000, 5.0)]), "most of the time"),
    ],
)
def test_a_poor_excitation_is_told(joint, sent, word):
    issues = examine(changed(joint, reference_deg=sent), library.rig_named("one-dof"))
    assert word in only(issues, "excitation").message


# ---- against the rig --------------------


CONTRADICTIONS: dict[str, tuple[Callable[[Columns], Columns], str, set[str], str]] = {
    "pressures": (lambda c: {P1: c[P2], P2: c[P1]}, "exchanged", {P1, P2}, "wrong"),
    "command": (lambda c: {"command": -c["command"]}, "sign", {"command"}, "wrong"),
    "bar": (lambda c: {P1: c[P1] / 100.0, P2: c[P2] / 100.0}, "unit", {P1, P2}, "wrong"),
    "percent": (lambda c: {"command": 100.0 * c["command"]}, "unit", {"command"}, "wrong"),
    "absolute": (
        lambda c: {P1: c[P1] + 101.3, P2: c[P2] + 101.3},
        "absolute-pressure",
        {P1, P2},
        "advice",
    ),
    "late": (lambda c: {ANGLE: np.roll(c[ANGLE], 12)}, "delay", {ANGLE}, "advice"),
    "early": (lambda c: {ANGLE: np.roll(c[ANGLE], -12)}, "delay", {ANGLE}, "advice"),
}


@pytest.mark.parametrize("case", CONTRADICTIONS)
def test_what_contradicts_the_rig_is_found(joint, case):
    change, kind, columns, severity = CONTRADICTIONS[case]
    spoilt = changed(joint, **change(joint.columns))
    issue = only(examine(spoilt, library.rig_named("one-dof")), kind)
    assert set(issue.columns) == columns and issue.severity == severity and issue.hint
    if kind == "delay":
        assert abs(issue.figures["delay_s"]) == pytest.approx(12 * PERIOD, abs=1.1 * PERIOD)


@pytest.mark.parametrize(
    ("a", "b"),
    [
        ("pressure_11_kpa", "pressure_21_kpa"),
        pytest.param("contraction_21", "contraction_22", marks=pytest.mark.slow),
        pytest.param("command_1", "command_2", marks=pytest.mark.slow),
        ("angle_1_deg", "angle_2_deg"),
    ],
)
def test_an_exchange_on_the_arm_is_found(a, b):
    arm, rig = sent_as("arm")
    issue = only(examine(changed(arm, **{a: arm.columns[b], b: arm.columns[a]}), rig), "exchanged")
    assert set(issue.columns) == {a, b}


# ---- figures, command, picture --------------------


@pytest.fixture(scope="module")
def spoilt(joint, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("spoilt") / "rec.csv"
    columns = {**joint.columns, P2: np.minimum(joint.columns[P2], 540.0)}
    write_recording(
        path,
        joint.time,
        columns,
        {"recording": {"rig": "one-dof", "loop": "closed"}, "known": joint.known},
    )
    return path


def test_check_tells_the_issues_and_writes_nothing(spoilt, capsys, cli):
    before = sorted(spoilt.parent.iterdir())
    said = cli("check", spoilt)
    assert said["schema"] == "pamid.check/1" and said["ok"]
    assert sorted(spoilt.parent.iterdir()) == before
    (issue,) = said["quality"]["issues"]
    assert issue["kind"] == "clipped" and issue["columns"] == [P2]
    assert issue["windows_s"] and issue["figures"]
    assert said["quality"]["channels"][P1].keys() == {"span", "step", "noise"}
    assert any(f["check"] == "clipped" and f["advice"] for f in said["findings"])
    assert run(["check", str(spoilt)]) == 0
    text = capsys.readouterr().out
    assert "note   clipped: pressure_2_kpa" in text and "\n1 note; nothing is wrong\n" in text
    assert text.rstrip().splitlines()[-1] == f"Next: pamid diagnose {spoilt}"
