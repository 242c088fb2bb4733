"""Reading a file that pamid wrote, as the model that describes it: what does not fit is refused
with its file, its place in it, and what should stand there."""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

from pamid.base.errors import FileError, nearest
from pamid.base.json_file import read_json
from pamid.base.schemas.model import Mismatch, Model, read

M = TypeVar("M", bound=Model)
REMEDY = "Run the command that wrote it again."


def read_result(
    path: Path, kind: type[M], *, also: tuple[str, ...] = (), any_schema: bool = False
) -> M | None:
    """The result in a file; None if there is no such file, FileError where it is damaged or of
    another schema (any_schema: of a later version, read as far as it is known). also: keys of its
    `not_read` that are needed here."""
    return need_result(path, kind, also=also, any_schema=any_schema) if path.exists() else None


def need_result(
    path: Path, kind: type[M], *, also: tuple[str, ...] = (), any_schema: bool = False
) -> M:
    """The same where there has to be a file: FileError if there is no such file, too."""
    content = read_json(path)
    if not isinstance(content, dict):
        raise FileError(f"{path} should hold a single JSON object.", REMEDY, code="damaged")
    schema = kind.model_fields["schema_"].default
    earlier = next((s for s in kind.earlier if s == content.get("schema")), None)
    if not any_schema and earlier is not None:
        raise outdated(path, kind, earlier)
    if not any_schema and content.get("schema") not in (schema, *kind.readable):
        actual = repr(content["schema"])[:60] if "schema" in content else "missing"
        raise damaged(path, "schema", repr(schema), actual)
    try:
        return read(kind, content, also=also)
    except Mismatch as mismatch:
        if mismatch.choices and isinstance(mismatch.value, str):
            hint = nearest(mismatch.value, mismatch.choices)
            raise FileError(
                f"{path}: there is no {mismatch.place} {mismatch.value!r:.60}.",
                hint or f"There are: {', '.join(mismatch.choices)}.",
                code="damaged",
            ) from None
        actual = "missing" if mismatch.missing else f"{mismatch.value!r:.60}"
        raise damaged(path, mismatch.place, mismatch.expected, actual) from None


def outdated(path: Path, kind: type[Model], schema: str) -> FileError:
    """The error of a file that an earlier version wrote under another schema: what has changed, and
    how to get the new schema."""
    now = kind.model_fields["schema_"].default
    return FileError(
        f"{path} was written by an earlier version of pamid ({schema}; now {now}): "
        f"{kind.earlier[schema]}.",
        f"Run `{kind.written_by}` on the same recordings again.",
        code="earlier-version",
    )


def damaged(path: Path, place: str, expected: str, actual: str) -> FileError:
    """The error of a file in which something else stands than what was expected."""
    return FileError(
        f"{path}: {place} should be {expected}, it is {actual}.", REMEDY, code="damaged"
    )
