"""Folder of numba's cache. Its files are pickles: whoever can write them runs code.

numba takes its settings, the folder of the cache among them, also from `.numba_config.yaml` in the
working folder. That file belongs to whoever packed the folder, and is not read. The cache is the
folder next to pamid's files where these can be written, else that of NUMBA_CACHE_DIR or of the
user. It is a new folder of this process where others may write that folder, where nobody can, or
without a home: numba would then take a folder called ~ in the working folder. A new folder costs
time and nothing else. What another version of pamid left in the folder is compiled anew.
"""

from __future__ import annotations

import os
from pathlib import Path

from numba import carray, cfunc, njit, types
from numba.core import caching, config

from pamid.base.trust import is_shared
from pamid.engine.cache_folder import home_cache, private_folder

# from here, so that nothing is compiled before `_settle`
__all__ = ["carray", "cfunc", "njit", "types"]


def _settle() -> None:
    """Numba's settings from the environment alone, its cache in a place that nobody else can
    write."""
    config._config_fname = os.devnull  # numba reads it before every compilation
    config.reload_config()
    chosen = getattr(config, "CACHE_DIR", "")
    if not chosen and os.access(Path(__file__).parent, os.W_OK):
        return
    folder = Path(chosen) if chosen else home_cache()
    # a folder that does not exist yet takes the rights of the nearest that does
    while folder is not None and not folder.exists() and folder != folder.parent:
        folder = folder.parent
    if folder is None or not os.access(folder, os.W_OK | os.X_OK) or is_shared(folder.lstat()):
        os.environ["NUMBA_CACHE_DIR"] = str(private_folder())
        config.reload_config()


class _IndexFile(caching.IndexDataCacheFile):
    """Index of compiled functions. One that names classes of another version counts as empty."""

    def _load_index(self) -> dict[object, str]:
        try:
            return dict(super()._load_index())
        except (ImportError, AttributeError):
            return {}


_settle()
caching.IndexDataCacheFile = _IndexFile  # type: ignore[misc]
