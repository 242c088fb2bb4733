"""The trial's arm: mechanics held against textbook equations, faults that act where they are
planted, its books."""

from dataclasses import asdict, replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from middle_draws import MIDDLE, Middle
from scipy.integrate import solve_ivp

from pamid.api import trial_cases
from pamid.base.errors import DataError, UsageError
from pamid.base.parallel.jobs import WorkerPool
from pamid.model.attachment import attachments
from pamid.model.registry import effects, rig_named
from pamid.model.rig import Rig
from pamid.recording.recording import Recording
from pamid.simulation.excitation.aprbs import aprbs
from pamid.trial.arm_faults import (
    ARM_FAULTS,
    JOINTS,
    MUSCLES,
    draw_site,
    draw_sizes,
    placed,
    reported,
    split,
)
from pamid.trial.arm_kernel import advance_arm
from pamid.trial.cases import Case, cases_sha256, draw_cases
from pamid.trial.faults import FAULTS, LONG_HOLDS, Planted
from pamid.trial.kernel import ANGLE, JOINT_STATES, LOAD_ANGLE
from pamid.trial.logger import Readout
from pamid.trial.machine import packed
from pamid.trial.machines.one_dof import NOISE, PERIOD_S, TO_COLUMN, Excitation
from pamid.trial.machines.two_link import (
    ARM_LAYOUT,
    TRUE_ARM,
    ArmSpecimen,
    draw_arm,
    record_arm,
)
from pamid.trial.scoring import score_cases

STEP = 1e-4  # s
SHORT = 3.3  # s, the least that has room for the holds


@cache
def machine(seed: int = 3, background: float = 0.01) -> ArmSpecimen:
    return draw_arm(np.random.default_rng(seed), background)


def reference(seconds: float) -> Any:
    return np.stack(
        [aprbs(seconds, PERIOD_S, 25.0, seed=1), aprbs(seconds, PERIOD_S, 35.0, seed=2)], axis=1
    )


@cache
def healthy(seconds: float = 6.0) -> dict[str, Any]:
    """A closed-loop recording without noise."""
    return record_arm(machine(), {}, Excitation(reference(seconds)), 0.5, Readout())


def replayed(
    planted: dict[str, dict[str, float]], seconds: float = 6.0, steps: int = 0
) -> dict[str, Any]:
    """The commands of the healthy arm given to one with faults."""
    command = np.stack([healthy(seconds)[f"command_{j}"] for j in JOINTS], axis=1)
    return record_arm(
        machine(), planted, Excitation(command, closed=False), 0.5, Readout(steps=steps)
    )


def change(one: dict[str, Any], other: dict[str, Any]) -> dict[str, float]:
    """RMS difference per channel, in standard deviations of its noise."""
    noise = ARM_LAYOUT.by_channel(NOISE) * ARM_LAYOUT.by_channel(TO_COLUMN)
    return {
        c: float(np.sqrt(np.mean((one[c] - other[c]) ** 2)) / noise[i])
        for i, c in enumerate(ARM_LAYOUT.channels)
    }


def middle(name: str) -> str:
    """The fault at the first of its places."""

    class First(Middle):
        def random(self) -> float:
            return 1.0

        def integers(self, count: int) -> int:
            return 0

    return draw_site(name, First())  # type: ignore[arg-type]


def sizes(site: str) -> dict[str, float]:
    return draw_sizes(site, MIDDLE)


# ---- links --------------------


def textbook(t: float, y: Any, p: dict[str, float]) -> list[float]:
    """Lagrange's equations in the joint angles, from masses, centres and inertias."""
    q1, q2, w1, w2 = y
    m1, c1, i1, m2, c2, i2, load = (
        p[k]
        for k in ("mass_1", "centre_1", "inertia_1", "mass_2", "centre_2", "inertia_2", "payload")
    )
    l1, l2, g = 0.40, 0.30, 9.81
    m = np.zeros((2, 2))
    rest = np.array([-p["viscous_1"] * w1, -p["viscous_2"] * w2])
    # two bodies that ride on link 1 and turn with link 2
    for mass, reach, own in ((m2, c2, i2), (load, l2, 0.0)):
        m += [
            [
                own + mass * (l1**2 + reach**2 + 2.0 * l1 * reach * np.cos(q2)),
                own + mass * (reach**2 + l1 * reach * np.cos(q2)),
            ],
            [own + mass * (reach**2 + l1 * reach * np.cos(q2)), own + mass * reach**2],
        ]
        h = mass * l1 * reach * np.sin(q2)
        rest += [
            h * (2.0 * w1 * w2 + w2**2) - mass * g * (l1 * np.sin(q1) + reach * np.sin(q1 + q2)),
            -h * w1**2 - mass * g * reach * np.sin(q1 + q2),
        ]
    m[0, 0] += i1 + m1 * c1**2
    rest[0] -= m1 * g * c1 * np.sin(q1)
    return [w1, w2, *np.linalg.solve(m, rest)]


def released(
    body: Any, at: tuple[float, float], seconds: float, **planted: Planted
) -> tuple[Any, Any]:
    """States (n, 2 joints, JOINT_STATES) of the arm let go at rest, and its records; planted: by
    joint_1, joint_2."""
    f = np.array(
        [
            packed(**asdict(planted.get(k, Planted())))
            for k in ("", "", "", "", "joint_1", "joint_2", "")
        ]
    )
    x = np.zeros((2, JOINT_STATES))
    x[:, ANGLE] = at
    x[:, LOAD_ANGLE] = at[0], at[0] + at[1]
    states = []
    for _ in range(round(seconds / STEP)):
        advance_arm(x, body, f, np.zeros(2), STEP)
        states.append(x.copy())
    return np.array(states), f


def drawn_body(
    payload: float, viscous: tuple[float, float] | None = None
) -> tuple[Any, dict[str, float]]:
    one = machine() if viscous is None else replace(machine(), viscous=viscous)
    return one.body(payload), {
        **one.links,
        "payload": payload,
        "viscous_1": one.viscous[0],
        "viscous_2": one.viscous[1],
    }


@pytest.mark.parametrize(("payload", "at"), [(0.0, (0.5, 0.9)), (0.5, (-1.0, 0.4))])
def test_a_free_swing_is_that_of_the_textbook(payload, at):
    body, p = drawn_body(payload)
    found = released(body, at, 3.0)[0][:, :, ANGLE]
    times = STEP * np.arange(1, len(found) + 1)
    known = (
        solve_ivp(
            textbook,
            (0.0, 3.0),
            [*at, 0.0, 0.0],
            t_eval=times[::50],
            args=(p,),
            rtol=1e-9,
            atol=1e-10,
        )
        .y[:2]
        .T
    )
    assert np.ptp(known, axis=0).min() > 0.5
    assert np.abs(found[::50] - known).max() < 3e-3


# ---- the machine --------------------


@pytest.mark.parametrize("seed", range(4))
def test_a_drawn_arm_is_within_its_tolerances(seed):
    one = machine(seed, 0.04)
    assert all(0.0 < abs(one.links[k] / TRUE_ARM[k] - 1.0) <= 0.25 for k in TRUE_ARM)
    first, second = one.joints
    assert first.waves.shape != second.waves.shape or not np.array_equal(first.waves, second.waves)
    assert (
        0.0 < abs(second.scale / first.scale - 1.0) <= 0.02
        and first.polytropic == second.polytropic
    )
    clean = [
        {k: v for k, v in asdict(j).items() if k != "waves"} for j in machine(seed, 0.0).joints
    ]
    assert clean[0] == clean[1], "without background one lot is one piece"


def test_the_healthy_arm_follows_its_references():
    found = healthy(20.0)
    assert list(found) == [
        "time_s",
        "reference_1_deg",
        "reference_2_deg",
        "command_1",
        "command_2",
        *ARM_LAYOUT.channels,
    ]
    for k, j in enumerate(JOINTS):
        late = reference(20.0)[:, k]
        settled = [i for i in range(300, late.size) if np.ptp(late[i - 300 : i + 1]) == 0.0]
        error = np.abs(found[f"angle_{j}_deg"] - late)[settled]
        assert len(settled) > 300 and np.median(error) < 3.0
        assert np.abs(found[f"angle_{j}_deg"]).max() < 50.0
    for i in MUSCLES:
        assert found[f"pressure_{i}_kpa"].min() > 60.0 and found[f"pressure_{i}_kpa"].max() < 720.0
        assert found[f"force_{i}_n"].min() > 0.0


# ---- faults --------------------


@pytest.mark.parametrize("name", ARM_FAULTS)
def test_a_fault_acts_and_at_zero_does_nothing(name):
    site, fault = middle(name), ARM_FAULTS[name]
    absent = replayed({site: {**sizes(site), **dict.fromkeys(fault.amounts, 0.0)}}, SHORT)
    assert all(np.array_equal(absent[c], healthy(SHORT)[c]) for c in absent)
    seconds = 20.0 if LONG_HOLDS in fault.needs else 6.0
    there = change(replayed({site: sizes(site)}, seconds), healthy(seconds))
    assert max(there.values()) > 1.0, f"{name} does not show: {there}"


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow) if k % 4 else name
        for k, name in enumerate(ARM_FAULTS)
    ],
)
def test_the_loop_holds_with_any_size(name):
    random = np.random.default_rng(7)
    site = draw_site(name, random)
    found = record_arm(
        machine(),
        {site: draw_sizes(site, random)},
        Excitation(reference(SHORT)),
        0.5,
        Readout(1.0, 1),
    )
    assert max(np.abs(found[f"angle_{j}_deg"]).max() for j in JOINTS) < 75.0, site
    assert all(np.isfinite(column).all() for column in found.values())


def test_every_fault_but_gravity_has_its_place_on_the_rig():
    assert set(FAULTS) - set(ARM_FAULTS) == {"gravity"}
    rig, random = rig_named("two-link"), np.random.default_rng(0)
    known = {a.label: a for a in attachments(rig, effects().values())}
    for name, fault in ARM_FAULTS.items():
        for site in {draw_site(name, random) for _ in range(60)}:
            place = split(site)[1]
            if not fault.exact:
                assert reported(place) in {rig.group_of(n) for n in rig.ports} | {
                    "valve",
                    "pressure",
                    "muscle",
                }, site
                continue
            # of what is one for the whole arm the rig has one attachment
            at = known.get(site) or known[name]
            assert (reported(place), fault.family) == (at.group(rig), at.family(rig)), site
            assert len(placed({site: sizes(site)})) == 7


def test_what_is_planted_stands_where_it_should():
    found = placed(
        {
            "leak@pressure_21": {"leak": 0.02},
            "coulomb-friction@joint_1": {"dahl_nm": 0.5},
            "tube-lag@valve": {"tube_s": 0.01},
            "supply-sag@valve": {"sag_pa": 1e4},
        }
    )
    assert [one.leak for one in found] == [0, 0, 0.02, 0, 0, 0, 0]
    assert [one.dahl_nm for one in found] == [0, 0, 0, 0, 0.5, 0, 0]
    assert [one.tube_s for one in found] == [0.01] * 4 + [0] * 3
    assert [one.sag_pa for one in found] == [0] * 6 + [1e4]
    for wrong in (
        "leak@pressure_31",
        "leak@joint_1",
        "leak",
        "gravity@joint_1",
        "leek@pressure_11",
    ):
        with pytest.raises(UsageError, match=wrong.partition("@")[0]):
            placed({wrong: {}})


# ---- cases --------------------


# But for `removed` these are the cases of a44c9df, compared field by field: the catalogue has grown
# since, and 13 or 14 withheld cases of 200 leave out what is new and of kin, too.
DIGESTS = {
    ("test", 0): "02c48409e14145c2",
    ("calibration", 0): "93b727c808a3d9df",
    ("test", 1): "01d98ae0270e9549",
    ("calibration", 1): "d01e448303abd004",
}


@pytest.mark.parametrize("nudge", [None, np.inf, -np.inf], ids=["here", "bits-up", "bits-down"])
def test_the_questions_put_to_the_joint_are_the_same_everywhere(nudge, monkeypatch):
    """On a processor, too, whose exp and log differ in the last bits."""
    if nudge is not None:
        exp = np.exp
        monkeypatch.setattr(np, "exp", lambda x: np.nextafter(np.nextafter(exp(x), nudge), nudge))
    for (part, seed), digest in DIGESTS.items():
        assert cases_sha256(draw_cases(part, 200, seed)).startswith(digest)


def example(planted: dict[str, dict[str, float]], **conditions: Any) -> Case:
    """A single fault in a short recording."""
    case = next(c for c in draw_cases("calibration", 60, 5, "two-link") if c.stratum == "single")
    quick = {
        "seconds": 9.0,
        "hold_s": (0.4, 1.6),
        "loop": "closed",
        "channels": "no-forces",
        "noise": 1.0,
        "background": 0.01,
        "payload_kg": 0.0,
    }
    return replace(
        case, planted=planted, conditions=replace(case.conditions, **{**quick, **conditions})
    )


@pytest.mark.parametrize(
    ("channels", "loop", "there"),
    [
        ("all", "closed", ("contraction_", "pressure_", "force_")),
        ("no-forces", "open", ("contraction_", "pressure_")),
        ("angles-and-pressures", "closed", ("pressure_",)),
    ],
)
def test_the_tool_sees_a_recording_and_a_catalogue(channels, loop, there, monkeypatch):
    shown: list[tuple[Recording, Rig]] = []

    def diagnose(recordings, rig, **how):
        shown.append((recordings[0], rig))
        raise DataError("seen enough")

    monkeypatch.setattr(trial_cases, "diagnose", diagnose)
    case = example({"leak@pressure_21": {"leak": 0.01}}, channels=channels, loop=loop)
    assert trial_cases.CaseWork()(case)["failed"]["message"] == "seen enough"
    ((recording, rig),) = shown
    expected = [c for c in ARM_LAYOUT.channels if c.startswith(("angle_", *there))]
    asked = ["reference_1_deg", "reference_2_deg"] if loop == "closed" else []
    assert list(recording.columns) == [*asked, "command_1", "command_2", *expected]
    assert rig.name == "two-link" and recording.known["payload_kg"] == 0.0
    assert recording.known["plane_deg"] == 90.0
    told = recording.path.with_suffix(".toml").name + repr(vars(recording))
    assert "leak" not in told and "single" not in told


@pytest.mark.slow
def test_a_case_of_the_arm_from_end_to_end(tmp_path):
    """A minute: a short recording and a small catalogue; delayed commands at joint 2, named with
    the joint."""
    few = {"dead-time", "coulomb-friction"}
    case = replace(
        example({"dead-time@command_2": {"delay_s": 0.03}}),
        removed=tuple(n for n in effects() if n not in few),
    )
    (found,) = trial_cases.run_cases([case], tmp_path, WorkerPool())
    assert found["failed"] is None and found["visibility"] > 1.5
    marked = score_cases([case.label()], [found])
    assert marked.rates["exact_first"].share == marked.rates["port_exact"].share == 1.0
