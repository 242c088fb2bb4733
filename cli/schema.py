"""`pamid schema`: List or print the JSON schemas of results and files."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import click

from pamid.api.options.record import argument
from pamid.base.errors import nearest

from . import frame

HELP_ORDER = 160
EXAMPLE = """
pamid schema diagnosis
"""


@dataclass(frozen=True)
class Arguments:
    """List the JSON schemas of results (--json) and of the files of a run, or print a schema.

    They follow JSON Schema, draft 2020-12, and serve editors and programs that read results. Later
    versions may add keys. No key changes its meaning within a number (pamid.diagnosis/3).
    """

    name: str | None = argument(default=None)


@frame.command("schema", Arguments, example=EXAMPLE)
def command(arguments: Arguments) -> frame.Result:
    known, name = schemas(), arguments.name
    if name is None:
        titles = {key: str(item["title"]) for key, item in known.items()}
        width = max(map(len, titles))
        return frame.Result(
            {"schema": "pamid.schemas/1", "schemas": titles},
            "\n".join(f"{key:{width}s}  {title}" for key, title in titles.items()),
        )
    from pamid.base.schemas import stem_of

    numbered = name.removeprefix("pamid.")
    stem = numbered if numbered in known else stem_of(name)
    if stem not in known:
        raise click.UsageError(f"There is no schema {name!r}. {nearest(stem, known)}".rstrip())
    schema = known[stem]
    return frame.Result(
        {"schema": "pamid.schemas/1", "schemas": {stem: schema}}, json.dumps(schema, indent=1)
    )


def schemas() -> dict[str, dict[str, Any]]:
    """Current schemas by name without `pamid.` and number; earlier ones with their number."""
    from pamid.base.schemas import all_schemas, earlier_schemas

    return dict(sorted((all_schemas() | earlier_schemas()).items()))
