"""Shared parts of commands that run many independent jobs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from pamid.base.errors import FileError


def finished_result(
    path: Path, text_of: Callable[[dict[str, Any]], str]
) -> tuple[dict[str, Any], str]:
    """JSON and text of a finished run; FileError if a file of it is damaged."""
    from pamid.base.json_file import read_json

    content = read_json(path)
    try:
        return content, text_of(content)
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        raise FileError(
            f"{path} is damaged: entries are missing or of the wrong type "
            f"({type(error).__name__}: {error}).",
            "Repeat the run with --overwrite.",
            code="damaged",
        ) from None


def failed_text(content: dict[str, Any]) -> list[str]:
    """A line per failed job."""
    return [f"Failed    {f['job']}: {f['why']}" for f in content.get("failed_jobs", ())]


def parameter_values(parameters: dict[str, Any]) -> str:
    """Parameters of a cause with their intervals, or with their word if the interval is empty."""
    return ", ".join(
        f"{k} {v['value']:.4g} "
        + (f"({v['low']:.4g} .. {v['high']:.4g})" if v["low"] < v["high"] else f"({v['word']})")
        for k, v in parameters.items()
    )
