"""Shared parts of commands that run many independent jobs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

cluster_option = click.option(
    "--cluster",
    metavar="tcp://HOST:8786",
    help="Hand the jobs to the Dask cluster of this scheduler instead; results "
    "are the same. Scheduler and workers must be trusted: jobs and results are pickled, so whoever "
    "can reach the scheduler can run code on the workers and here. Over TLS: tls://HOST:8786, with "
    "certificates from Dask's configuration or DASK_DISTRIBUTED__COMM__TLS__CA_FILE, "
    "..__CLIENT__CERT, ..__CLIENT__KEY. (pip install 'pamid[cluster]')",
)


def said_of(path: Path, text_of: Callable[[dict[str, Any]], str]) -> tuple[dict[str, Any], str]:
    """JSON and text of a finished run; FileError where an earlier run, which --resume takes as
    done, was changed."""
    from pamid.base.errors import FileError
    from pamid.base.json_file import read_json

    content = read_json(path)
    try:
        return content, text_of(content)
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        raise FileError(
            f"{path} is damaged: it lacks entries, or they are not what they should be "
            f"({type(error).__name__}: {error}).",
            "Make the run again with --overwrite.",
            code="damaged",
        ) from None


def failed_text(content: dict[str, Any]) -> list[str]:
    """A line per job that failed."""
    return [f"Failed    {f['job']}: {f['why']}" for f in content.get("failed_jobs", ())]


def parameter_values(parameters: dict[str, Any]) -> str:
    """A cause's parameters, each with its interval, or with how it is known without one."""
    return ", ".join(
        f"{k} {v['value']:.4g} "
        + (f"({v['low']:.4g} .. {v['high']:.4g})" if v["low"] < v["high"] else f"({v['word']})")
        for k, v in parameters.items()
    )
