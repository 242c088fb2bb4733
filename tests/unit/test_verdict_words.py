"""What the sentence of a verdict says of a family without a law, and of what is left."""

from __future__ import annotations

from typing import Any

import pytest
from synthetic_run import diagnosis_json

from pamid.diagnosis.verdict_words import (
    AS_IN_FILE,
    _entrance,
    amount_of,
    free_families,
    sentence,
)
from pamid.schemas.diagnosis_file import DiagnosisFile, PortShare, Remainder, Where
from pamid.schemas.model import read

FORM = "of the friction family, in a form not in the catalogue"


def said(**changes: Any) -> DiagnosisFile:
    """Of an effect that is unknown; changes: of the best model's only member."""
    made = diagnosis_json("unknown-effect")
    return read(DiagnosisFile, made | {"members": [made["members"][0] | changes]})


def test_the_nearest_of_the_catalogue_is_named_beside_a_form_that_is_not_in_it() -> None:
    found = said()
    assert free_families(found).startswith(f"{FORM} (the nearest in it is coulomb-friction")
    assert free_families(found).endswith("(P 0.12), 86 % of the gap)")
    assert free_families(found) in sentence(found)


@pytest.mark.parametrize(
    "other",
    [
        {"family": "drag"},
        {"removes": None},
        {"removes": {"share": 0.4, "low": -0.1, "high": 0.7}},
    ],
)
def test_what_is_of_another_family_or_not_sure_to_help_is_not_the_nearest(
    other: dict[str, Any],
) -> None:
    assert free_families(said(**other)) == FORM


@pytest.mark.parametrize(
    ("left", "words"),
    [
        ({"floors": 1.4}, "what remains is within noise and tolerances."),
        (
            {"floors": 14.0, "probability": 0.66},
            "what remains, 14 times the noise floor, is not told from ordinary tolerances (P 0.66 "
            "that it is more).",
        ),
        (
            {"floors": 14.0, "probability": 0.4, "probable_from": 0.78},
            "what remains, 14 times the noise floor, is not told from ordinary tolerances (P 0.40 "
            "that it is more; it counts from 0.78 on).",
        ),
        (
            {"floors": 14.0, "probability": 0.02, "probable_from": 0.78},
            "what remains, 14 times the noise floor, is not told from ordinary tolerances (P 0.02 "
            "that it is more).",
        ),
        (
            {"floors": 14.0, "probability": None},
            "what remains, 14 times the noise floor, is not told from ordinary tolerances.",
        ),
    ],
)
def test_what_tolerances_alone_have_to_answer_for_is_said_with_its_size(
    left: dict[str, Any], words: str
) -> None:
    made = diagnosis_json("explained")
    found = read(DiagnosisFile, made | {"remainder": made["remainder"] | left})
    assert sentence(found).endswith(f"; {words}")


@pytest.mark.parametrize(
    ("missing", "passing", "unit", "words"),
    [
        (
            0.3,
            10.0,
            "N m",
            "0.3 N m (root mean square, estimated there) missing to the model as fitted, 3 % "
            "of the 10 N m that pass there",
        ),
        (
            0.05,
            0.02,
            "",
            "0.05 (root mean square, estimated there) missing to the model as fitted, 2.5 "
            "times the 0.02 that pass there",
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


@pytest.mark.parametrize(
    ("missing", "background", "words"),
    [
        (0.2, {}, "A map that is rough by 2 % there would look alike."),
        (0.9, {}, ""),
        (None, {}, ""),
        (0.2, {"force_map_1": {"pull": 0.8, "share_of_gap": 0.04}}, ""),
    ],
)
def test_what_a_rough_map_would_leave_is_not_called_material_alone(
    missing: float | None, background: dict[str, Any], words: str
) -> None:
    made = diagnosis_json("unknown-effect")
    rest = made["remainder"] | {"missing_rms": missing, "passing_rms": 10.0, "unit": "N m"}
    found = read(DiagnosisFile, made | {"remainder": rest, "background": background})
    assert ("would look alike" in sentence(found)) == bool(words)
    assert sentence(found).endswith(words)


SHARES = (PortShare(port="sensor", share=0.48), PortShare(port="block", share=0.26))


@pytest.mark.parametrize(
    ("together", "words"),
    [
        (
            (("block", "sensor"),),
            " It enters at the block port, or at sensor: these sensors do not tell them apart.",
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
