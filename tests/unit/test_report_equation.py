"""Equations on the page: set from the code that is fitted, for every effect of the catalogue, and
from the text of a formula; nothing that a file says becomes markup."""

import re
import xml.etree.ElementTree as xml

import pytest
from markupsafe import Markup
from synthetic_run import diagnosis_json, make_run

from pamid.engine.symbolic.expression import Expr, symbol, symbols
from pamid.engine.symbolic.vocabulary import (
    absolute,
    bristle,
    clip,
    exp,
    sign,
    smooth_step,
    sqrt,
    stop,
    where,
)
from pamid.model.attachment import attachments
from pamid.model.registry import effects, rig_named
from pamid.report.equation import acting, cause_equations
from pamid.report.formatting import SPACE
from pamid.report.formula import FormulaError, formula_html
from pamid.report.load import RunData, load_run
from pamid.report.mathml import Typeset, name

X, A = symbol("signal", "x"), symbol("parameter", "a")
LABELS = [
    (rig, one.label)
    for rig in ("one-dof", "two-link")
    for one in attachments(rig_named(rig), effects().values())
]


def read(math: str) -> str:
    """What a reader sees, one line; the markup must be sound."""
    return "".join(xml.fromstring(f"<all>{math}</all>").itertext()).replace(SPACE, " ")


def set_in_type(node: Expr) -> Markup:
    return Typeset(lambda space, key: name(key))(node)


@pytest.mark.parametrize(
    "node, expected",
    [
        (X - A * (stop(X, A) * (1.0 / A)), '<mrow><mi>x</mi><mo form="infix">−</mo><mfrac>'),
        (sign(X) * 2.0, "<mi>sgn</mi>"),
        (clip(X, 0.0, A), "<mi>clip</mi>"),
        (smooth_step(X), "<mi>step</mi>"),
        (bristle(X, A), "<mi>bristle</mi>"),
        (X * X * X, "<msup><mi>x</mi><mn>3</mn></msup>"),
        (sqrt(absolute(X)), '<msqrt><mrow><mo fence="true" form="prefix">|</mo>'),
        (exp(-X), "<msup><mi>e</mi>"),
        (where(X > 0.0, A, 0.0), "otherwise"),
        (6.283185307179586 * X, "<mn>2</mn><mi>π</mi>"),
        (0.25 * X, "<mfrac><mi>x</mi><mn>4</mn></mfrac>"),
        (1.5e-7 * X, '<msup><mn>10</mn><mrow><mo form="prefix">−</mo><mn>7</mn></mrow></msup>'),
    ],
)
def test_the_vocabulary_is_typeset(node, expected):
    found = set_in_type(node)
    assert expected in found
    read(found)


@pytest.mark.parametrize("rig, label", LABELS, ids=["-".join(one) for one in LABELS])
def test_every_effect_of_the_catalogue_has_an_equation(rig, label):
    found = acting(rig, label)
    assert found is not None
    parts = [found.value, *found.rates.values()]
    text = "".join(read(set_in_type(one)) for one in parts)
    used = {key for space, key in symbols(parts) if space == "parameter"}
    assert used and used <= set(found.names) == {one.name for one in found.effect.parameters}
    assert all(key.replace("_", " ") in text for key in used), text


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> RunData:
    diagnosis = diagnosis_json("explained")
    diagnosis["causes"][0]["parameters"]["give_rad"] = {
        "value": 0.0007,
        "low": 0.0006,
        "high": 0.0008,
    }
    return load_run(
        make_run(
            tmp_path_factory.mktemp("run") / "RUN", diagnosis=diagnosis, without=("residual.csv",)
        )
    )


def test_the_cause_is_told_in_names_and_in_values(run):
    html = "".join(cause_equations(run))
    text = read(html)
    assert "The equation of Coulomb friction at the joint port, and with the values found" in text
    assert "M′=M−torque⋅stop(position,give)give" in text
    assert "M′=M−0.41N m⋅stop(position,0.0007rad)0.0007rad" in text
    assert (
        "M: the torque without the effect, M′ with it." in text
        and "stop: Elastic-perfectly-plastic" in text
    )
    assert re.findall(r'alttext="([^"]*)"', html)[0].startswith(
        "M′ = M - torque * (position - play(position, give))"
    )


# ---- formulas --------------------


@pytest.mark.parametrize(
    "text, expected",
    [
        ("-0.42 sign(velocity) + 0.11 contraction^2", "−0.42⋅sign(velocity)+0.11⋅contraction2"),
        (
            "missing [N m] = -12.3 velocity/(37.1 deg/s) |velocity/(37.1 deg/s)| -0.2 (x/0.17)^3",
            "missing [N m]=−12.3⋅velocity37.1deg/s⋅|velocity37.1deg/s|−0.2⋅(x0.17)3",
        ),
        ("+1.2e-05 1", "1.2×10−5"),
        ("0.3 x -0.04 1 -0.1 x^3", "0.3⋅x−0.04−0.1⋅x3"),
    ],
)
def test_a_formula_is_typeset(text, expected):
    assert read(formula_html(text)) == expected


@pytest.mark.parametrize(
    "text",
    [
        "",
        "(",
        "a)",
        "|a",
        "a ^ b",
        "1 +",
        "a || b",
        "<b>a</b>",
        "a; b",
        "(" * 50 + "a" + ")" * 50,
        "a [",
        "= 3",
        "\u202ea",
    ],
)
def test_what_is_no_formula_is_refused(text):
    with pytest.raises(FormulaError):
        formula_html(text)
