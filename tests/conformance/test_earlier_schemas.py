"""Schemas of earlier files: printed, valid, and with the fate of every key that is gone."""

import json
import re
import sys
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator
from pamid_cli.frame import run

from pamid.base.schemas import all_schemas, earlier_schemas, stem_of
from pamid.base.schemas.diagnosis_file import DiagnosisFile

sys.path.append(str(Path(__file__).resolve().parents[2] / "docs" / "hooks"))

import reference

each = pytest.mark.parametrize("number", sorted(earlier_schemas()))


def keys(schema: dict[str, Any]) -> set[str]:
    """Every key of a schema that says nothing of what became of it."""
    bare = json.loads(re.sub(r'"\$comment": "gone', '"$comment": "was', json.dumps(schema)))
    return set(reference._commented(bare, bare, ""))


def test_every_earlier_form_that_is_read_is_shown():
    shown = {schema["$id"] for schema in earlier_schemas().values()}
    assert shown == set(DiagnosisFile.readable)


@each
def test_it_is_printed_under_its_number(number, capsys):
    assert run(["schema", f"pamid.{number}"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["$id"] == printed["properties"]["schema"]["const"] == f"pamid.{number}"
    Draft202012Validator.check_schema(printed)
    assert run(["schema"]) == 0
    assert re.search(f"^{re.escape(number)} ", capsys.readouterr().out, re.MULTILINE)


@each
def test_what_became_of_every_key_is_told(number):
    earlier = earlier_schemas()[number]
    now = keys(all_schemas()[stem_of(number)])
    fates = reference._commented(earlier, earlier, "")
    gone = {path for path in fates if path not in now}
    assert gone and all(fates[path].startswith("gone") for path in gone)
    assert not [path for path, fate in fates.items() if fate.startswith("gone") and path in now]
    named = {name for fate in fates.values() for name in re.findall(r"`([^` ]+)`", fate)}
    assert named <= now | {"explained", "notes"}, named - now


@each
def test_the_page_has_a_row_for_every_key(number):
    page = dict(reference.written_pages())["reference/schemas.md"]
    table = page.partition(f"key of pamid.{number}")[2].partition("## ")[0]
    rows = set(re.findall(r"^\| `([^`]+)` \|", table, re.MULTILINE))
    assert set(earlier_schemas()[number]["properties"]) <= rows
    assert {"how_far.*.black_box", "remainder.p_value", "ranking[].signature"} <= rows
