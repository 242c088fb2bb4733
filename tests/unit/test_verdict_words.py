"""The sentences of every verdict: shares first, then probabilities, then what remains."""

from typing import Any

import pytest
from synthetic_run import diagnosis_json

from pamid.base.schemas.diagnosis_file import DiagnosisFile
from pamid.base.schemas.model import read
from pamid.diagnosis.verdict.verdict_words import sentence, shortened


def changed(verdict: str, **changes: Any) -> DiagnosisFile:
    """A diagnosis of this verdict; changes: of its top-level keys."""
    return read(DiagnosisFile, diagnosis_json(verdict) | changes)


def cause(effect: str, share: float, probability: float, **more: Any) -> dict[str, Any]:
    made = diagnosis_json("explained")["causes"][0]
    removes = {"share": share, "low": share - 0.1, "high": share + 0.1}
    return made | {"effect": effect, "probability": probability, "removes": removes} | more


def left(share: float, **more: Any) -> dict[str, Any]:
    return diagnosis_json("explained")["remainder"] | {"share": share} | more


# ---- what causes remove -------------------------------------------------------------------------


def test_a_cause_is_told_with_its_share_first_and_its_probability_behind():
    assert sentence(changed("explained")) == (
        "coulomb-friction at the joint port removes 86 % of the gap (P 0.91). The best of another "
        "family, bouc-wen-hysteresis, removes 48 %. 14 % of the gap remains, and the error "
        "is 1.4 times the noise floor."
    )


def test_several_causes_remove_a_share_together():
    causes = [cause("coulomb-friction", 0.6, 0.91), cause("leak", 0.25, 0.8, port="pressure")]
    assert sentence(changed("explained", causes=causes, remainder=left(0.15, floors=1.2))) == (
        "coulomb-friction at the joint port (P 0.91) and leak at the pressure port (P 0.80) "
        "together remove 85 % of the gap, without coulomb-friction 25 % and without leak 60 %. "
        "15 % of the gap remains, and the error is 1.2 times the noise floor."
    )


@pytest.mark.parametrize(
    ("effect", "text"),
    [
        ("leak", "leak"),
        ("play@a + play@b", "play@a + play@b"),
        ("play@a + play@b + play@c", "play@a and 2 more ports"),
        ("play@a + play@b + leak@c", "play@a + play@b + leak@c"),
    ],
)
def test_an_effect_at_many_ports_is_shortened(effect, text):
    assert shortened(effect) == text


# ---- what remains -------------------------------------------------------------------------------


SIZE = "14 % of the gap remains, and the error is 1.4 times the noise floor."
PLACE = {"real": True, "port": "muscle"}


@pytest.mark.parametrize(
    ("rest", "words"),
    [
        ({"floors": 14.0}, SIZE.replace("1.4", "14")),
        ({"floors": 1.03}, "the error is at the noise floor."),
        ({"floors": 0.4}, "the error is at the noise floor."),
        ({"floors": None}, "14 % of the gap remains."),
        ({"share": -0.02}, SIZE.replace("14 %", "0 %")),
        ({"port": "muscle"}, SIZE),
        (PLACE, f"{SIZE} It enters at the muscle port."),
        (PLACE | {"family": "drag"}, "port, where a curve of the drag family removes it."),
    ],
)
def test_what_remains_is_told_with_size_and_place(rest, words):
    assert sentence(changed("explained", remainder=left(0.14) | rest)).endswith(f" {words}")


# ---- no cause -----------------------------------------------------------------------------------


def test_no_gap_is_told_with_what_the_model_leaves():
    assert sentence(changed("no-structural-gap")) == (
        "No structural gap was found. The refitted model leaves 1.1 times the noise floor. "
        "No effect and no curve at a port removes a material share of this error."
    )
    assert "is at the noise floor" in sentence(changed("no-structural-gap", remainder=None))


def test_few_windows_leave_the_leader_open():
    assert sentence(changed("cannot-tell")) == (
        "coulomb-friction may be missing. It removes 24 % of the gap (95 % interval 4 to 44 %, "
        "from 18 held-out windows), which is not certain enough. Record for longer, or with larger "
        "excitation."
    )
    assert sentence(changed("cannot-tell", ranking=[])).startswith("The refitted model leaves")
