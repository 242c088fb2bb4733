"""The stories of notebooks/ as notebooks: `python tests/support/stories.py` writes each .ipynb from
its .py.

The .py is the source. Notebooks are kept without outputs, so that a change of a story shows as one
in what people read, and their cells are numbered, so that writing them again changes nothing.
"""

import warnings
from pathlib import Path

import jupytext
import nbformat

FOLDER = Path(__file__).resolve().parents[2] / "notebooks"


def notebook_text(story: Path) -> str:
    """The .ipynb of a story as text."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # jupytext's own, of its readers
        notebook = jupytext.read(story)
    notebook.metadata.pop("jupytext", None)
    for number, cell in enumerate(notebook.cells):
        cell["id"] = f"cell-{number}"
    nbformat.validate(notebook)
    return nbformat.writes(notebook, version=nbformat.NO_CONVERT) + "\n"


if __name__ == "__main__":
    for path in sorted(FOLDER.glob("*.py")):
        path.with_suffix(".ipynb").write_text(notebook_text(path), encoding="utf-8")
