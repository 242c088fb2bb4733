"""What commands print and what the files of a run hold: a model per file, from which pamid writes,
reads and describes it; small outputs of commands as shipped JSON schemas."""

from __future__ import annotations

import importlib
import json
from importlib import resources
from typing import Any

#: name without `pamid.` and its number -> module of this package and its model
MODELS = {
    "check": ("check", "CheckFile"),
    "diagnosis": ("diagnosis", "DiagnosisFile"),
    "error": ("error", "ErrorFile"),
    "fit": ("fit", "FitFile"),
    "network": ("network", "NetworkFile"),
    "new-rig": ("new_rig", "NewRigFile"),
    "run": ("run", "RunFile"),
    "trial": ("trial", "TrialFile"),
}


def all_schemas() -> dict[str, dict[str, Any]]:
    """Every JSON schema by name, without `pamid.` and its number."""
    from pamid.schemas.model import json_schema

    found = {
        name: json_schema(getattr(importlib.import_module(f"pamid.schemas.{module}"), kind))
        for name, (module, kind) in MODELS.items()
    }
    for file in resources.files("pamid.schemas").iterdir():
        if file.name.endswith(".json"):
            shipped = json.loads(file.read_text(encoding="utf-8"))
            found[file.name.removesuffix(".json")] = shipped
    return dict(sorted(found.items()))
