"""An environment of their own for packages that a benchmark compares with: never pamid's."""

import os
import subprocess
import venv
from pathlib import Path

CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "pamid"


def python_with(folder: Path, packages: list[str]) -> Path:
    """The Python of an environment with these packages; made where it is not there yet."""
    python = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    done, wanted = folder / "installed.txt", "\n".join(packages)
    if done.exists() and done.read_text() == wanted:
        return python
    if folder.exists() and any(folder.iterdir()) and not (folder / "pyvenv.cfg").exists():
        raise SystemExit(
            f"{folder} holds something else than an environment. Name an empty or a new folder."
        )
    print(f"making an environment for the peers in {folder}", flush=True)
    if not python.exists():
        venv.create(folder, with_pip=True)
    subprocess.run(
        [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *packages],
        check=True,
    )
    done.write_text(wanted)
    return python
