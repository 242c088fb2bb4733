"""A place for compiled code where the user has no home that can be written, as in a container or a
system service."""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from functools import lru_cache
from pathlib import Path


def home_cache() -> Path | None:
    """The user's folder for caches; None where the user has no home."""
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    except RuntimeError:  # neither HOME nor an entry for this user in the password file
        return None


@lru_cache(maxsize=1)
def private_folder() -> Path:
    """An empty folder of this process alone, removed when it ends."""
    folder = Path(tempfile.mkdtemp(prefix="pamid-"))
    # Code of a process is of no use to the next, and temporary folders of a service are
    # rarely cleaned.
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder
