"""Where numba keeps what it has compiled. Its files are pickles: whoever can write them runs code.

numba takes its settings, the folder of the cache among them, also from `.numba_config.yaml` in the working folder: that
is data of whoever packed the folder, and is not read. Its cache is the one beside pamid's own files where these can be
written, else that of NUMBA_CACHE_DIR or of the user; where others may write that one, it is a new folder of this
process, which costs time and nothing else.
"""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from pathlib import Path

from numba import njit
from numba.core import config
from numba.misc.appdirs import AppDirs

from pamid.trust import is_shared

__all__ = ["njit"]      # from here, so that nothing is compiled before `_settle`


def _settle() -> None:
    """Numba's settings from the environment alone, its cache in a place that nobody else can write."""
    config._config_fname = os.devnull       # asked for again before every compilation
    config.reload_config()
    chosen = Path(found) if (found := getattr(config, "CACHE_DIR", "")) else None
    if chosen is None and os.access(Path(__file__).parent, os.W_OK):
        return
    if _others_may_write(chosen or Path(AppDirs(appname="numba", appauthor=False).user_cache_dir)):
        folder = tempfile.mkdtemp(prefix="pamid-")
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
        setattr(config, "CACHE_DIR", folder)  # noqa: B010 (made by numba as it reads its settings)


def _others_may_write(folder: Path) -> bool:
    """Of the folder, or of the nearest above it that is there."""
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return is_shared(folder.lstat())


_settle()
