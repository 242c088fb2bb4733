"""A place for compiled code where the user has no home that can be written, as in a container or a system service."""

from __future__ import annotations

import atexit
import os
import shutil
import sys
import tempfile
from functools import lru_cache
from pathlib import Path


def user_cache() -> Path:
    """The user's folder for caches; a private one for this process where there is no home."""
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    except RuntimeError:        # neither HOME nor an entry for this user in the password file
        return private_folder()


@lru_cache(maxsize=1)
def private_folder() -> Path:
    """An empty folder of this process alone, removed when it ends."""
    folder = Path(tempfile.mkdtemp(prefix="pamid-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def settle_numba() -> None:
    """Name numba a folder where it would find none (an error), or take one called ~ in the working folder, which is
    anybody's."""
    if os.environ.get("NUMBA_CACHE_DIR") or _writable(Path(__file__).parent / "__pycache__"):
        return
    if private_folder.cache_info().currsize or not _writable(user_cache()):
        os.environ["NUMBA_CACHE_DIR"] = str(private_folder())
        if "numba" in sys.modules:
            sys.modules["numba"].config.reload_config()     # type: ignore[attr-defined]


def _writable(folder: Path) -> bool:
    """Can files be made in it, or it be made?"""
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return folder.is_dir() and os.access(folder, os.W_OK | os.X_OK)
