"""Networks of several channels in a run: `network.json` is the network that was trained last,
those of other channels lie in `networks/CHANNEL/` with the same files.

The name of a folder comes from data: only plain words of a channel's form are taken for a channel.
"""

from __future__ import annotations

import re
from pathlib import Path

from pamid.base.errors import FileError
from pamid.base.run_folder import NETWORK_FILE, WEIGHTS_FILE

NETWORKS_FOLDER, TRACE_FILE = "networks", "trace.csv"
NETWORK_FILES = (NETWORK_FILE, WEIGHTS_FILE, TRACE_FILE)
_CHANNEL = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,200}")


def channel_network_files(channel: str) -> tuple[str, ...]:
    """The files of a channel's network next to that of the run, relative to the run; FileError for
    a name that is no channel's."""
    if _CHANNEL.fullmatch(channel) is None:
        raise FileError(f"{channel!r} is not a channel name that can name a folder.")
    return tuple(f"{NETWORKS_FOLDER}/{channel}/{name}" for name in NETWORK_FILES)


def channel_networks(folder: Path) -> dict[str, Path]:
    """The folders of a run's other networks by channel, in alphabetical order."""
    files = (folder / NETWORKS_FOLDER).glob(f"*/{NETWORK_FILE}")
    return {
        path.parent.name: path.parent
        for path in sorted(files)
        if _CHANNEL.fullmatch(path.parent.name)
    }
