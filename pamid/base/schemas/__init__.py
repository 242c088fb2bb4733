"""Models of the JSON that commands print and that runs contain: a pydantic model per object, by
which pamid writes, reads and describes it. The folder is scanned: a model with a `schema_` is a
file.
"""

from __future__ import annotations

import importlib
import json
import pkgutil
from importlib.resources import files
from typing import Any


def all_schemas() -> dict[str, dict[str, Any]]:
    """Every JSON schema by name, without `pamid.` and its number."""
    from pamid.base.schemas.model import Model, json_schema

    modules = (
        importlib.import_module(f"{__name__}.{iter_module.name}")
        for iter_module in pkgutil.iter_modules(__path__)
    )
    schemas = {
        kind.model_fields["schema_"].default: json_schema(kind)
        for module in modules
        for kind in vars(module).values()
        if isinstance(kind, type) and issubclass(kind, Model) and "schema_" in kind.model_fields
    }
    return dict(sorted((stem_of(name), schema) for name, schema in schemas.items()))


def earlier_schemas() -> dict[str, dict[str, Any]]:
    """Schemas of files that are still read, by name and number: "diagnosis/2". The `$comment` of a
    key states its later form."""
    schemas = {}
    for item in sorted(files(__name__).iterdir(), key=lambda path: path.name):
        if item.name.endswith(".json"):
            schema = json.loads(item.read_text(encoding="utf-8"))
            schemas[str(schema["$id"]).removeprefix("pamid.")] = schema
    return schemas


def stem_of(name: str) -> str:
    """ "pamid.diagnosis/3" -> "diagnosis"."""
    return name.removeprefix("pamid.").partition("/")[0]
