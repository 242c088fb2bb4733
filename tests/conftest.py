"""Whatever any test makes pamid print or write as JSON is held against its shipped schema."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pamid_cli.frame as frame
import pytest
from jsonschema import Draft202012Validator
from pamid_cli.schema import schemas

import pamid.base.json_file as json_file

VALIDATORS = {schema["$id"]: Draft202012Validator(schema) for schema in schemas().values()}
#: of tests only, and the list of schemas itself
UNDESCRIBED = ("pamid.test/1", "pamid.schemas/1", "pamid.calibration/2")

_unchecked: list[bool] = []


#: words, exit status -> the object that `pamid ... --json` prints
Cli = Callable[..., dict[str, Any]]


@pytest.fixture
def cli(capsys) -> Cli:
    """Run a command with --json to this exit status."""

    def printed(*words, code=0):
        capsys.readouterr()
        status = frame.run([*map(str, words), "--json"])
        shown = capsys.readouterr()
        assert status == code, (words, shown)
        return dict(json.loads(shown.out))

    return printed


@pytest.fixture
def here(tmp_path, monkeypatch) -> Path:
    """An empty working folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def undrawn(monkeypatch):
    """Leave the pictures of reports blank, for tests of what stands beside them."""
    from report_pages import blank

    monkeypatch.setattr("pamid.report.writing.render", blank)


@pytest.fixture
def unchecked() -> Iterator[None]:
    """Leave JSON that this test makes pamid write unchecked."""
    _unchecked.append(True)
    yield
    _unchecked.pop()


def require_valid(text: str) -> None:
    """The object fits the schema it names; an object without one belongs to no schema."""
    said = json.loads(text)
    name = said.get("schema") if isinstance(said, dict) else None
    if not isinstance(name, str) or name in UNDESCRIBED:
        return
    assert name in VALIDATORS, f"no schema is shipped for {name}"
    errors = sorted(
        VALIDATORS[name].iter_errors(said), key=lambda error: list(map(str, error.path))
    )
    told = [f"{name}: {'.'.join(map(str, one.path))}: {one.message[:200]}" for one in errors[:5]]
    assert not told, "\n".join(told)


@pytest.fixture(autouse=True, scope="session")
def _every_object_is_as_described() -> Iterator[None]:
    """A test of damaged files takes `unchecked`: what pamid hands on of them is as wrong as it
    was."""

    def watched(made):
        def text(*arguments):
            found = made(*arguments)
            if not _unchecked:
                require_valid(found)
            return found

        return text

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(frame, "_json", watched(frame._json))
        patch.setattr(json_file, "json_text", watched(json_file.json_text))
        yield
