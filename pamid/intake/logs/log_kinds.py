"""Kinds of logs, from a scan of the folder `readers`, and reading of a log in this process."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from pamid.base.errors import FileError, PamidError
from pamid.base.scanned import modules_of
from pamid.intake.logs.channel_builder import ChannelBuilder
from pamid.intake.logs.channels import Log


@dataclass(frozen=True)
class Kind:
    """A kind of log.

    read       enters the channels of the builder's file
    marks      first bytes of such a file, none for plain text
    extra      extra of pamid to install for it, "" if none
    packages   packages of the extra, which `read` imports when it is called
    """

    name: str
    suffixes: tuple[str, ...]
    read: Callable[[ChannelBuilder], None]
    marks: tuple[bytes, ...] = ()
    extra: str = ""
    packages: tuple[str, ...] = ()


@lru_cache
def known_kinds() -> dict[str, Kind]:
    """Every kind by its name: the `KIND` of each file in `pamid.intake.logs.readers`."""
    modules = modules_of("pamid.intake.logs.readers").values()
    return {module.KIND.name: module.KIND for module in modules if hasattr(module, "KIND")}


def read_here(path: Path, kind: str) -> Log:
    """Signals of a log of this kind, read in this process; FileError for every fault of it."""
    reader = known_kinds()[kind]
    try:
        builder = ChannelBuilder(path)
        reader.read(builder)
        return builder.log(kind)
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
            f"{path} cannot be read as {kind}: there is not enough memory.",
            "Export fewer channels or a shorter part of it.",
            code="too-large",
        ) from error
    except Exception as error:  # a foreign reader may raise anything on a damaged file
        reason = " ".join(str(error).split())[:200] or "no reason given"
        raise FileError(
            f"{path} cannot be read as {kind}: {reason} ({type(error).__name__}).",
            "It may be damaged, incomplete or of another kind. Export it again from the program "
            "that wrote it.",
            code="damaged",
        ) from error
