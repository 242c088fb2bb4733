"""The models of what is printed and written, as a room: each has a name of its own."""

from __future__ import annotations

from pamid.schemas import all_schemas, stem_of
from pamid.schemas.model import Model


def kinds(of: type[Model]) -> list[type[Model]]:
    return [one for kind in of.__subclasses__() for one in (kind, *kinds(kind))]


def test_no_two_models_bear_one_name() -> None:
    found = all_schemas()
    named = [
        kind.model_fields["schema_"] for kind in kinds(Model) if "schema_" in kind.model_fields
    ]
    names = [field.default for field in named]
    assert sorted(names) == sorted(one["$id"] for one in found.values())
    assert sorted(map(stem_of, names)) == sorted(found)
    assert all(one["title"] and "schema" in one["required"] for one in found.values())
