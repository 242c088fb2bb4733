"""The kinds of log there are, found by scanning `pamid.ingest.readers`, and the reading of one in
this process."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from pamid.base.errors import FileError, PamidError
from pamid.base.scanned import modules_of
from pamid.ingest.channels import Log


@dataclass(frozen=True)
class Kind:
    """A kind of log. marks: what such a file begins with; none for plain text. extra: what to
    install for it, "" if nothing; packages: what that brings, imported by `read` only when it is
    called."""

    name: str
    suffixes: tuple[str, ...]
    read: Callable[[Path], Log]
    marks: tuple[bytes, ...] = ()
    extra: str = ""
    packages: tuple[str, ...] = ()


@lru_cache
def known_kinds() -> dict[str, Kind]:
    """Every kind by its name: the `KIND` of each file in `pamid.ingest.readers`."""
    modules = modules_of("pamid.ingest.readers").values()
    return {module.KIND.name: module.KIND for module in modules if hasattr(module, "KIND")}


def read_here(path: Path, kind: str) -> Log:
    """The signals of a log of this kind, read in this process. FileError whatever is wrong with
    it."""
    reader = known_kinds()[kind]
    try:
        return reader.read(path)
    except PamidError:
        raise
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] not in reader.packages:
            raise
        raise FileError(
            f"{path}: reading such a {kind} file needs {error.name}, which is not installed.",
            f"pip install 'pamid[{reader.extra}]'",
            code="missing-extra",
        ) from error
    except MemoryError as error:
        raise FileError(
            f"{path} cannot be read as {kind}: it needs more memory than there is.",
            "Export fewer channels or a shorter stretch of it.",
            code="too-large",
        ) from error
    except Exception as error:  # a damaged file makes a foreign reader raise just about anything
        reason = " ".join(str(error).split())[:200] or "no reason given"
        raise FileError(
            f"{path} cannot be read as {kind}: {reason} ({type(error).__name__}).",
            "It may be damaged, incomplete or of another kind: open it with the program that wrote "
            "it and export it again.",
            code="damaged",
        ) from error
