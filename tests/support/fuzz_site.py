"""The folder in which a fuzz input is written."""

import shutil
from dataclasses import dataclass
from pathlib import Path
from random import Random

Words = tuple[str | Path, ...]


@dataclass(frozen=True)
class Site:
    """An empty folder for an input, the whole files to damage, and the source of chance."""

    seeds: Path
    place: Path
    random: Random

    def copy(self, name: str) -> Path:
        """Copy a whole file or folder into the place."""
        source, target = self.seeds / name, self.place / Path(name).name
        return Path(
            shutil.copytree(source, target) if source.is_dir() else shutil.copy(source, target)
        )

    def one_of(self, *names: str) -> str:
        return self.random.choice(names)
