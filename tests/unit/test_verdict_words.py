"""The sentences of every verdict: shares first, then probabilities, then what remains."""

from __future__ import annotations

from typing import Any

import pytest
from report_pages import VERDICTS
from synthetic_run import diagnosis_json

from pamid.report.formatting import effect_label
from pamid.schemas.diagnosis_file import DiagnosisFile, PortShare, Remainder, Where
from pamid.schemas.model import read
from pamid.verdict.verdict_words import (
    AS_IN_FILE,
    _entrance,
    advice_of,
    amount_of,
    free_families,
    sentence,
    size_of,
)

FORM = "of the friction family, in a form that is not in the catalogue"


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


def test_a_cause_is_told_with_its_share_first_and_its_probability_behind() -> None:
    assert sentence(changed("explained")) == (
        "coulomb-friction at the joint port removes 86 % of the gap (P 0.91). The best of another "
        "family, bouc-wen-hysteresis, removes 48 %. 14 % of the gap remains, 1.4 times the noise "
        "floor."
    )


def test_the_next_family_is_none_of_the_alternatives_of_the_cause() -> None:
    causes = [cause("coulomb-friction", 0.86, 0.91, instead=["muscle-hysteresis"])]
    assert "The best of another family, dead-time, removes 9 %." in sentence(
        changed("explained", causes=causes)
    )
    assert "another family" not in sentence(changed("explained", ranking=[]))


def test_what_is_set_aside_is_neither_the_next_family_nor_the_leader() -> None:
    ranking = diagnosis_json("explained")["ranking"]
    ranking[2]["set_aside"] = ["reach_m of bouc-wen-hysteresis ended at a bound"]
    assert "The best of another family, dead-time, removes 9 %." in sentence(
        changed("explained", ranking=ranking)
    )
    ranking = diagnosis_json("cannot-tell")["ranking"]
    ranking[0]["set_aside"] = ["torque_n_m of coulomb-friction ended at nothing"]
    assert sentence(changed("cannot-tell", ranking=ranking)).startswith("lugre-friction may be")


def test_a_place_that_the_recordings_cannot_separate_stands_with_the_cause() -> None:
    causes = [cause("coulomb-friction", 0.86, 0.91, or_at=["motor"])]
    assert sentence(changed("explained", causes=causes)).startswith(
        "coulomb-friction at the joint port (or equally at the motor port) removes 86 % of the gap"
    )


def test_a_place_stands_before_the_share_of_the_second_of_a_set() -> None:
    causes = [cause("offset", 0.86, 0.68), cause("gain-drift", 0.78, 0.47, or_at=["motor"])]
    text = sentence(changed("ambiguous", causes=causes))
    assert "(or equally at the motor port), 78 % (P 0.47)." in text and ",," not in text


def test_a_doubt_about_the_recording_follows_the_verdict() -> None:
    doubt = "height_mm is offset by -1850 mm against rig 'hoist'."
    assert sentence(changed("explained", doubts=[doubt])).endswith(
        f" First mend the recording: {doubt}"
    )


def test_a_port_in_the_name_is_not_repeated() -> None:
    causes = [cause("coulomb-friction@joint", 0.86, 0.91)]
    assert sentence(changed("explained", causes=causes)).startswith(
        "coulomb-friction@joint removes 86 % of the gap (P 0.91)."
    )


def test_several_causes_remove_a_share_together() -> None:
    causes = [cause("coulomb-friction", 0.6, 0.91), cause("leak", 0.25, 0.8, port="pressure")]
    assert sentence(changed("explained", causes=causes, remainder=left(0.15, floors=1.2))) == (
        "coulomb-friction at the joint port (P 0.91) and leak at the pressure port (P 0.80) "
        "together remove 85 % of the gap, without coulomb-friction 25 % and without leak 60 %. "
        "15 % of the gap remains, 1.2 times the noise floor."
    )


def test_a_pair_of_which_neither_does_anything_alone() -> None:
    causes = [cause("offset", 0.75, 0.7), cause("leak", 0.74, 0.6, port="pressure")]
    words = sentence(changed("partly-explained", causes=causes, remainder=left(0.3, floors=9.0)))
    assert "together remove 70 % of the gap. None of them removes any of it without" in words


def test_two_that_cannot_be_separated_stand_with_their_shares() -> None:
    assert sentence(changed("ambiguous")).startswith(
        "coulomb-friction at the joint port removes 86 % of the gap (P 0.91). These recordings "
        "cannot separate it from leak at the pressure port, 85 % (P 0.38). 14 % of the gap remains"
    )


def test_more_that_predict_the_same_are_one_group() -> None:
    causes = [cause(name, 0.86, 0.5) for name in ("coulomb-friction", "offset", "leak")]
    assert sentence(changed("ambiguous", causes=causes)).startswith(
        "On these recordings coulomb-friction, offset and leak predict the same and cannot be "
        "separated. Each removes about 86 % of the gap."
    )


# ---- what remains -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("rest", "words"),
    [
        ({"floors": 14.0}, "14 % of the gap remains, 14 times the noise floor."),
        ({"floors": 1.03}, "14 % of the gap remains, at the noise floor."),
        ({"floors": 0.4}, "14 % of the gap remains, at the noise floor."),
        ({"floors": None}, "14 % of the gap remains."),
        ({"share": -0.02}, "0 % of the gap remains, 1.4 times the noise floor."),
        ({"port": "muscle"}, "14 % of the gap remains, 1.4 times the noise floor."),
        (
            {"real": True, "port": "muscle"},
            "14 % of the gap remains, 1.4 times the noise floor. It enters at the muscle port.",
        ),
        (
            {"real": True, "port": "muscle", "family": "drag"},
            "1.4 times the noise floor. It enters at the muscle port, where a curve of the drag "
            "family removes it.",
        ),
    ],
)
def test_what_remains_is_told_with_size_and_place(rest: dict[str, Any], words: str) -> None:
    assert sentence(changed("explained", remainder=left(0.14) | rest)).endswith(f" {words}")


def test_an_interval_of_what_remains() -> None:
    rest = read(Remainder, left(0.36, low=0.3, high=0.42, floors=3.7))
    assert size_of(rest, beside=True) == (
        "36 % of the gap (95 % interval 30 to 42 %), 3.7 times the noise floor in the worst channel"
    )
    assert size_of(rest, beside=False) == "3.7 times the noise floor in the worst channel"


# ---- no cause -----------------------------------------------------------------------------------


def test_a_curve_of_a_family_is_told_with_its_share() -> None:
    found = changed("unknown-effect")
    assert free_families(found) == FORM
    assert sentence(found) == (
        "No effect of the catalogue removes a material share of the gap. A curve at the muscle "
        f"port removes 77 % of it. The effect is {FORM}."
    )


def test_curves_that_tie_are_told_with_every_port_and_family() -> None:
    unknown = diagnosis_json("unknown-effect")["unknown"]
    (form,) = unknown["free_forms"]
    others = [form | {"port": "joint"}, form | {"port": "joint", "family": "drag"}]
    found = changed("unknown-effect", unknown=unknown | {"free_forms": [form, *others]})
    assert sentence(found).endswith(
        "A curve at the muscle port, or equally at the joint port, removes 77 % of it. The effect "
        "is of the friction or drag family, in a form that is not in the catalogue."
    )


def test_a_gap_without_a_curve_is_told_with_its_place() -> None:
    found = changed("unknown-effect", unknown=None)
    assert free_families(found) == ""
    assert sentence(found).endswith(
        "A curve at one of its ports does. It enters at the joint port."
    )


def test_no_gap_is_told_with_what_the_model_leaves() -> None:
    assert sentence(changed("no-structural-gap")) == (
        "No structural gap was found. The refitted model leaves 1.1 times the noise floor, of "
        "which no effect and no curve at a port removes a material share."
    )
    assert "is at the noise floor" in sentence(changed("no-structural-gap", remainder=None))


def test_few_windows_leave_the_leader_open() -> None:
    assert sentence(changed("cannot-tell")) == (
        "coulomb-friction may be missing. It removes 24 % of the gap (95 % interval 4 to 44 %, "
        "from 18 held-out windows), which is not certain enough. Record for longer, or with larger "
        "excitation."
    )
    assert sentence(changed("cannot-tell", ranking=[])).startswith("The refitted model leaves")


def test_too_many_that_remove_as_much_are_listed() -> None:
    step = diagnosis_json("ambiguous")["comparison"][0]
    third = step["tied"][1] | {"effect": "offset"}
    comparison = [step | {"tied": [*step["tied"], third]}]
    assert sentence(changed("cannot-tell", comparison=comparison)) == (
        "coulomb-friction removes 86 % of the gap, but leak and offset remove as much. These "
        "recordings cannot separate them."
    )


@pytest.mark.parametrize("verdict", VERDICTS)
def test_no_sentence_has_more_than_thirty_words(verdict: str) -> None:
    parts = sentence(changed(verdict)).split(". ")
    assert max(len(part.split()) for part in parts) <= 30


# ---- size at a port -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("missing", "passing", "unit", "words"),
    [
        (
            0.3,
            10.0,
            "N m",
            "an estimated 0.3 N m rms is missing, 3 % of the 10 N m that pass there",
        ),
        (
            0.05,
            0.02,
            "",
            "an estimated 0.05 rms is missing, 2.5 times the 0.02 that pass there",
        ),
        (0.3, 0.0, "N m", ""),
        (None, None, "", ""),
    ],
)
def test_what_is_missing_is_said_in_the_ports_unit(
    missing: float | None, passing: float | None, unit: str, words: str
) -> None:
    made = diagnosis_json("unknown-effect")["remainder"]
    rest = {"missing_rms": missing, "passing_rms": passing, "unit": unit}
    assert amount_of(read(Remainder, made | rest)) == words


SHARES = (PortShare(port="sensor", share=0.48), PortShare(port="block", share=0.26))


@pytest.mark.parametrize(
    ("together", "words"),
    [
        (
            (("block", "sensor"),),
            " It enters at the block port, or at sensor: these sensors cannot separate them.",
        ),
        ((), " It enters at the block port."),
        ((("sensor", "heater"),), " It enters at the block port."),
    ],
)
def test_a_port_that_takes_as_much_is_named_where_nothing_tells_them_apart(
    together: tuple[tuple[str, ...], ...], words: str
) -> None:
    where = Where(port="block", ports=SHARES, indistinguishable=together)
    assert _entrance(where, AS_IN_FILE) == words


def test_a_port_with_less_of_the_gap_is_not_named() -> None:
    where = Where(port="sensor", ports=SHARES, indistinguishable=(("block", "sensor"),))
    assert _entrance(where, AS_IN_FILE) == " It enters at the sensor port."


@pytest.mark.parametrize(
    "real, floors, advised", [(False, 370.0, True), (False, 1.2, False), (True, 370.0, False)]
)
def test_an_immaterial_remainder_far_above_the_floor_is_looked_into(
    real: bool, floors: float, advised: bool
) -> None:
    rest = read(Remainder, left(0.05, floors=floors, real=real))
    assert ("diagnose again" in advice_of(rest)) == advised


# ---- one effect at several ports -----------------------------------------------------------------


def rubbing(*ports: str, verdict: str = "explained", rig_ports: tuple[str, ...] = ()) -> str:
    causes = [cause(f"coulomb-friction@{port}", 0.3, 0.91, port=port) for port in ports]
    mapped = [
        {"port": name, "group": name, "kind": "motion", "unit": "N m", "leads_to": []}
        for name in rig_ports or ports
    ]
    rig = {"name": "arm", "inputs": [], "outputs": [], "ports": mapped}
    return sentence(changed(verdict, causes=causes, rig=rig, remainder=left(0.1)))


def test_friction_in_all_joints_is_one_finding() -> None:
    text = rubbing("shoulder", "elbow")
    assert text.startswith(
        "coulomb-friction in the joints (P 0.91) removes 90 % of the gap, without "
        "coulomb-friction@shoulder 60 % and without coulomb-friction@elbow 60 %."
    )


def test_friction_in_some_joints_names_them() -> None:
    text = rubbing("shoulder", "wrist", rig_ports=("shoulder", "elbow", "wrist"))
    assert text.startswith(
        "coulomb-friction at shoulder and wrist (P 0.91) removes 90 % of the gap"
    )


def test_an_alternative_at_several_ports_is_one_member_of_the_set() -> None:
    causes = [
        cause("coulomb-friction@a", 0.9, 0.5, port="a"),
        cause("coulomb-friction@b", 0.9, 0.5, port="b"),
        cause("gain-drift@c", 0.88, 0.4, port="c"),
    ]
    assert sentence(changed("ambiguous", causes=causes)).startswith(
        "coulomb-friction at a and b removes 90 % of the gap (P 0.50). These recordings cannot "
        "separate it from gain-drift@c, 88 % (P 0.40)."
    )


def test_labels_of_one_effect_at_several_ports_are_read_as_one() -> None:
    several = "coulomb-friction@joint_1 + coulomb-friction@joint_2"
    assert effect_label(several) == "Coulomb friction at joint 1 and joint 2"
    assert effect_label("play@a + dead-time@b") == "play at a + dead time at b"
