"""Effects by the shape of the error that they cause."""

import json

from pamid_cli.frame import run

from pamid.base.symptoms import SYMPTOMS
from pamid.model.registry import effects


def test_every_effect_has_symptoms_and_every_symptom_effects():
    known = effects()
    assert all(kind.symptoms for kind in known.values())
    assert {s for kind in known.values() for s in kind.symptoms} == set(SYMPTOMS)


def test_effects_are_listed_by_symptom(capsys):
    assert run(["--json", "effects", "--symptom", "stops-short"]) == 0
    rows = json.loads(capsys.readouterr().out)["effects"]
    names = {row["name"] for row in rows}
    assert "coulomb-friction" in names and "dead-time" not in names
    assert all("stops-short" in row["symptoms"] for row in rows)


def test_an_unknown_symptom_lists_the_known_ones(capsys):
    assert run(["effects", "--symptom", "wobbles"]) == 2
    assert "stops-short" in capsys.readouterr().err
