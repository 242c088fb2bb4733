"""The models of what is printed and written, as a room: each has a name of its own."""

import json

import pytest
from pamid_cli.frame import run
from pamid_cli.table import COMMANDS

from pamid.base.schemas import all_schemas, stem_of
from pamid.base.schemas.diagnosis_file import DiagnosisFile
from pamid.base.schemas.model import Model


def kinds(of: type[Model]) -> list[type[Model]]:
    return [one for kind in of.__subclasses__() for one in (kind, *kinds(kind))]


def test_no_two_models_bear_one_name():
    found = all_schemas()
    named = [
        kind.model_fields["schema_"]
        for kind in kinds(Model)  # results of the Python API are the models that they print
        if "schema_" in kind.model_fields and kind.__module__.startswith("pamid.base.schemas.")
    ]
    names = [field.default for field in named]
    assert sorted(names) == sorted(one["$id"] for one in found.values())
    assert sorted(map(stem_of, names)) == sorted(found)
    assert all(one["title"] and "schema" in one["required"] for one in found.values())


@pytest.mark.parametrize("name", ["diagnosis", "pamid.diagnosis/3", "pamid.diagnosis"])
def test_a_schema_is_printed_with_its_number(name, capsys):
    assert run(["schema", name]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["$id"] == printed["properties"]["schema"]["const"] == "pamid.diagnosis/3"
    assert {"partly-explained", "cannot-tell"} < set(printed["properties"]["verdict"]["enum"])


def test_every_earlier_schema_says_what_has_changed_and_what_writes_the_new_one():
    told = [kind for kind in kinds(Model) if kind.earlier]
    assert DiagnosisFile in told
    for kind in told:
        now = kind.model_fields["schema_"].default
        assert all(stem_of(old) == stem_of(now) and old != now for old in kind.earlier)
        assert all(len(why) > 20 for why in kind.earlier.values())
        assert kind.written_by.removeprefix("pamid ") in COMMANDS
