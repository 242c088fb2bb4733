"""The table of operators: value, derivative, machine code, C, MATLAB, ONNX, NumPy and plain text
agree for each of its entries, and for one that is added here."""

import ctypes
import math
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from compiled import program, run, sensitivities, state

from pamid.base.arrays import Array
from pamid.engine.program import Stepping
from pamid.engine.symbolic.derivative import gradients
from pamid.engine.symbolic.expression import ZERO, Expr, apply, const, substitute, text, where
from pamid.engine.symbolic.operators import OPERATORS, Operator
from pamid.exports.c_source import asset, helpers
from pamid.exports.statements import MATLAB, C, Statements, Symbol

A, B = state("a"), state("b")
POINTS = ((0.7, 1.31), (1.9, 0.42), (0.23, 0.26))  # where every operator is smooth
ADDED = Operator(
    "atan",
    1,
    math.atan,
    lambda apply, y, a: (1.0 / (1.0 + a * a),),
    llvm=("call double @atan(double {0})",),
    onnx="Atan",
    numpy="arctan",
    c="atan",
    matlab="atan",
)
NAMES = [*OPERATORS, ADDED.name]


@pytest.fixture(autouse=True, scope="module")
def _with_one_more() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(OPERATORS, ADDED.name, ADDED)
        yield


def root(name: str) -> Expr:
    """An operator inside others, so that parentheses count: z = op(a + b, a b + 0.3), a - z (b -
    z)."""
    z = apply(name, *(A + B, A * B + 0.3)[: OPERATORS[name].arity])
    return A - z * (B - z)


def roots() -> list[Expr]:
    return [root(name) for name in NAMES]


def at(node: Expr, point: tuple[float, float]) -> float:
    """The value where both states are constants: what folding makes of it."""
    values = {A: const(point[0]), B: const(point[1])}
    return float(substitute([node], values)[0])


def expected() -> Array:
    """points x operators"""
    return np.array([[at(node, point) for node in roots()] for point in POINTS])


def slope(node: Expr, by: Expr, point: tuple[float, float]) -> float:
    return at(gradients([node])[0].get(by, ZERO), point)


@pytest.mark.parametrize("name", NAMES)
def test_plain_text_and_numpy_mean_the_same(name):
    operator = OPERATORS[name]
    for a, b in POINTS:
        arguments = (a, b)[: operator.arity]
        value = getattr(np, operator.numpy)(*arguments)
        assert float(value) == pytest.approx(float(operator.evaluate(*arguments)), rel=1e-14)
        words = {**vars(math), "a": a, "b": b}
        assert float(eval(text(root(name)), words)) == pytest.approx(at(root(name), (a, b)))


def test_machine_code_gives_values_and_derivatives():
    nodes = roots()
    outputs = dict(zip(NAMES, nodes, strict=True))
    made, u = program({"a": ZERO, "b": ZERO}, outputs), np.zeros(1)
    for point, values in zip(POINTS, expected(), strict=True):
        np.testing.assert_allclose(run(made, u, (), point)[0], values, rtol=1e-13)
        found = sensitivities(made, u, (), point, Stepping())[0]
        exact = [[slope(node, by, point) for by in (A, B)] for node in nodes]
        np.testing.assert_allclose(found, exact, rtol=1e-12, atol=1e-13)


def test_the_condition_of_a_choice_is_not_differentiated(monkeypatch):
    def refuse(*_):
        raise AssertionError("a condition has no derivative")

    monkeypatch.setitem(OPERATORS, "tanh", replace(OPERATORS["tanh"], derivative=refuse))
    chosen = where(apply("tanh", A) > 0.4, A * B, A)
    assert at(gradients([chosen])[0][A], (0.7, 1.31)) == 1.31
    assert at(gradients([chosen])[0][A], (0.2, 1.31)) == 1.0


@pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler")
def test_c_gives_the_values(tmp_path):
    places: dict[Symbol, str] = {("state", "a"): "x[0]", ("state", "b"): "x[1]"}
    targets = {f"y[{i}]": node for i, node in enumerate(roots())}
    head = "void f(const double x[], double y[]) {"
    body = "\n".join([head, *Statements(C, roots(), places).stored(targets), "}"])
    (tmp_path / "f.c").write_text("\n".join(["#include <math.h>", *helpers(body), body]))
    library = tmp_path / "f.so"
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC"]
    subprocess.run(["cc", *flags, "f.c", "-o", library, "-lm"], cwd=tmp_path, check=True)
    function = ctypes.CDLL(str(library)).f
    for point, values in zip(POINTS, expected(), strict=True):
        y = (ctypes.c_double * len(NAMES))()
        function((ctypes.c_double * 2)(*point), y)
        np.testing.assert_allclose(list(y), values, rtol=1e-13)


OCTAVE = shutil.which("octave-cli") or shutil.which("octave")


@pytest.mark.skipif(OCTAVE is None, reason="there is no octave")
def test_matlab_gives_the_values(tmp_path):
    assert OCTAVE is not None
    places: dict[Symbol, str] = {("state", "a"): "x(1)", ("state", "b"): "x(2)"}
    targets = {f"y({i})": node for i, node in enumerate(roots(), 1)}
    body = ["function y = f(x)", *Statements(MATLAB, roots(), places).stored(targets), "end"]
    (tmp_path / "f.m").write_text("\n".join([*body, asset("helpers.m")]))
    calls = [f"printf('%.17g ', f([{a!r}, {b!r}]));" for a, b in POINTS]
    (tmp_path / "script.m").write_text("\n".join(calls))
    done = subprocess.run(
        [OCTAVE, "--no-history", "--norc", "--no-gui", "script.m"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    found = np.array(done.stdout.split(), float).reshape(len(POINTS), -1)
    np.testing.assert_allclose(found, expected(), rtol=1e-13)


def test_onnx_gives_the_values():
    onnx = pytest.importorskip("onnx", reason="pip install 'pamid[onnx]'")
    reference = pytest.importorskip("onnx.reference")
    from pamid.exports.onnx_graph import Graph, Values, graph_of, model_bytes

    graph = Graph()
    values = Values(graph, {("state", "a"): "a", ("state", "b"): "b"})
    graph.named("y", graph.joined([values(node) for node in roots()]))
    made = graph_of(graph, "f", {"a": (1,), "b": (1,)}, {"y": (len(NAMES),)}, outermost=True)
    cell = reference.ReferenceEvaluator(onnx.load_from_string(model_bytes(made, {})))
    for (a, b), numbers in zip(POINTS, expected(), strict=True):
        (found,) = cell.run(None, {"a": np.array([a]), "b": np.array([b])})
        np.testing.assert_allclose(found, numbers, rtol=1e-13)
