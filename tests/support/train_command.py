"""`pamid train-residual` as a test calls it, and what it says."""

import json
from pathlib import Path
from typing import Any

import pytest
from pamid_cli import frame


def train(folder: Path, *options: str) -> int:
    """Its exit code."""
    return frame.run(["train-residual", str(folder), *options])


def said(capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    """Its one JSON object."""
    found = json.loads(capsys.readouterr().out)
    assert isinstance(found, dict)
    return found
