"""Mechanisms as equations: MuJoCo's forward dynamics at random states as the judge, finite
differences for the partials that are written in closed form."""

from functools import cache

import mechanisms
import numpy as np
import pytest

from pamid.engine.llvm_ir import with_partials
from pamid.engine.symbolic.derivative import gradients
from pamid.engine.symbolic.expression import ZERO, plain, symbol, walk
from pamid.engine.symbolic.vocabulary import Expr, held, sin, tangent
from pamid.model.assembly import Assembly

mechanisms.needs_mujoco()

MODELS = {
    "one": mechanisms.ONE,
    "two": mechanisms.TWO,
    "tree": mechanisms.TREE,
    "seven": mechanisms.SEVEN,
    "terms": mechanisms.TERMS,
    "drone": mechanisms.DRONE,
    "rubbing": mechanisms.SEVEN.replace('frictionloss="0.1"', 'frictionloss="1.5"'),
}
CLOSE = 1e-10


@pytest.fixture(autouse=True)
def _opened_once(monkeypatch) -> None:
    """Let the judge compile a file once per test, not once per state."""
    monkeypatch.setattr(mechanisms, "open_mujoco", cache(mechanisms.open_mujoco))


@pytest.mark.parametrize("name", MODELS)
def test_mujoco_gives_the_same_accelerations_and_readings(name, tmp_path):
    rig = mechanisms.rig_from(MODELS[name], tmp_path)
    assert not rig.mechanism.hindrances
    _judge(rig, mechanisms.parameters(rig))


@pytest.mark.parametrize("name", ["terms", "seven", "rubbing"])
def test_constraints_follow_masses_and_armatures_as_in_mujoco(name, tmp_path):
    """Their softness is in proportion to the inverse inertia of the changed model."""
    rig = mechanisms.rig_from(MODELS[name], tmp_path)
    factors = np.random.default_rng(4).uniform(0.5, 2.0, len(rig.parameters)).tolist()
    p = {
        k: v * (f if k.endswith(("_mass", "_armature")) else 1.0)
        for (k, v), f in zip(mechanisms.parameters(rig).items(), factors, strict=True)
    }
    assert p != mechanisms.parameters(rig)
    _judge(rig, p)


def _judge(rig: mechanisms.CompiledMechanism, p: dict[str, float]) -> None:
    """Compare with MuJoCo at random states and these values of the parameters."""
    here, random = mechanisms.AtStates(rig), np.random.default_rng(1)
    for _ in range(20):
        x = {s.name: float(random.choice([-1, 1]) * random.uniform(0.4, 2.0)) for s in rig.states}
        # from speeds at which some joints creep to those at which all friction is at its loss
        speed = random.choice([0.01, 0.1, 1.0])
        x |= {k: speed * v for k, v in x.items() if k.endswith("_velocity")}
        # an activation is never beyond its range
        x |= {k: 0.2 * x[k] for a in rig.mechanism.actuators for k, _ in a.states}
        x |= _within_yield(rig, x, random)
        u = {column: float(random.normal()) for column in rig.inputs}
        rates, readings = here(x, u, p)
        judged, read = mechanisms.mujoco_at(rig, x, u, p)
        scale = max(map(abs, judged.values()))
        for key, value in judged.items():
            assert rates[key] == pytest.approx(value, rel=CLOSE, abs=CLOSE * scale), key
        for joint in rig.mechanism.joints:
            assert rates[joint.name] == x[f"{joint.name}_velocity"]
        assert set(read) <= set(readings)
        for key, value in read.items():
            assert readings[key] == pytest.approx(value, rel=CLOSE, abs=CLOSE), key


def _within_yield(
    rig: mechanisms.CompiledMechanism, x: dict[str, float], random: np.random.Generator
) -> dict[str, float]:
    """Where springs that yield are relaxed: never further away than they can be stretched."""
    return {
        j.spring_state: x[j.name] - j.spring_yield * float(random.uniform(-0.9, 0.9))
        for j in rig.mechanism.joints
        if j.spring_state
    }


def _bent(rig: mechanisms.CompiledMechanism, at: set[str]) -> dict[str, Expr]:
    """The rig's rates where something nonlinear acts at some ports."""

    def port(name: str, value: Expr, **signals: Expr) -> Expr:
        if name not in at:
            return value
        return 0.8 * value + 0.3 * sin(signals["position"]) * signals["velocity"]

    names = [mechanisms._Names(space) for space in ("state", "input", "parameter")]
    return dict(rig.rates(*names, port))  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["two", "tree", "rubbing", "terms"])
@pytest.mark.parametrize("bent", [False, True])
def test_partials_equal_finite_differences(name, bent, tmp_path):
    rig = mechanisms.rig_from(MODELS[name], tmp_path)
    joints = rig.mechanism.joints
    last = [p.name for p in rig.mechanism.ports if p.kind == "transmission"][-1]
    at = {joints[0].name, last} if bent else set()
    rates = _bent(rig, at)
    wanted = [f"{j.name}_velocity" for j in joints]
    roots = [rates[k] for k in wanted]
    values, slopes = plain(roots), gradients(roots)
    random = np.random.default_rng(2)
    p = mechanisms.parameters(rig)
    point = {("state", s.name): float(random.choice([-1, 1]) * random.uniform(0.5, 1.5))
             for s in rig.states}  # fmt: skip
    x = {name: value for (_, name), value in point.items()}
    point |= {("state", k): v for k, v in _within_yield(rig, x, random).items()}
    point |= {("input", c): float(random.uniform(0.1, 0.4)) for c in rig.inputs}
    point |= {k: 0.03 * v for k, v in point.items() if k[1].endswith("_velocity")}
    # off the corners: a loss of zero is one
    point |= {("parameter", k): v or 0.02 for k, v in p.items()}

    def at_point(nodes, moved):
        return mechanisms.numbers(plain(nodes), {**point, **moved})

    size = np.abs(at_point(values, {})).max()
    keys = [k for k in point if k[0] != "input"]
    flat = at_point([g.get(symbol(*k), ZERO) for g in slopes for k in keys], {})
    exact = flat.reshape(len(roots), len(keys)).T
    for key, column in zip(keys, exact, strict=True):
        h = 1e-6 * max(abs(point[key]), 0.1)
        up, down = ({key: point[key] + s * h} for s in (1, -1))
        found = (at_point(values, up) - at_point(values, down)) / (2.0 * h)
        np.testing.assert_allclose(
            column, found, rtol=2e-6, atol=2e-7 * (size + np.abs(found).max()), err_msg=str(key)
        )


def test_a_held_value_has_no_derivative_and_a_tangent_has_its_own():
    x = symbol("state", "x")
    node = x * held(sin(x)) + tangent(x * x, 5.0 * x)
    (by,) = gradients([node])
    value, slope = mechanisms.numbers(plain([node, by[x]]), {("state", "x"): 0.7})
    assert value == pytest.approx(0.7 * np.sin(0.7) + 0.49)
    assert slope == pytest.approx(np.sin(0.7) + 5.0)


def test_seven_joints_are_a_short_program(tmp_path):
    """In operations, which do not depend on the machine: with what 28 sensitivities need less than
    three times the plain equations, and few enough to be compiled at once."""
    rig = mechanisms.rig_from(mechanisms.SEVEN, tmp_path)
    assembly = Assembly(rig).for_fitting()
    # the shape of the last body is fitted as well, by exponentials
    shape = {p.name for p in rig.on_request["link7_inertia"]}
    sensitive = assembly.program.sensitive - shape
    assert len(sensitive) == 28
    rates = list(assembly.traced.rates.values())
    columns: dict[tuple[str, str], int] = {}

    def column(space, name):
        return columns.setdefault((space, name), len(columns))

    values, _, _ = with_partials(rates, column, sensitive)
    count = [sum(bool(n.args) for n in walk(nodes)) for nodes in (plain(rates), values)]
    assert count[0] < 5000 and count[1] < 3.0 * count[0]
