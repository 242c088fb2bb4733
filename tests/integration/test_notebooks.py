"""Every story in notebooks/ runs as a plain script and leaves nothing behind; its notebook is what
jupytext makes of it, and runs in a kernel."""

import os
import re
import subprocess
import sys
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient
from stories import notebook_text

ROOT = Path(__file__).resolve().parents[2]
STORIES = sorted((ROOT / "notebooks").glob("*.py"))
#: the first is quick; the others take half a minute and more each
RUNS = [
    pytest.param(story, id=story.stem, marks=pytest.mark.slow if k else ())
    for k, story in enumerate(STORIES)
]


def files_of_the_repository() -> set[Path]:
    """Everything but what Python, the tools and git keep for themselves, or make on the side."""
    hidden = re.compile(r"/(\.[^/]+|__pycache__)(/|$)")
    return {
        p
        for folder in ("notebooks", "data")
        for p in (ROOT / folder).rglob("*")
        if not hidden.search(str(p))
    }


@pytest.mark.parametrize("story", STORIES, ids=lambda story: story.stem)
def test_a_notebook_is_its_story(story):
    told = story.read_text(encoding="utf-8")
    assert not re.search(r"(from|import) (pamid\.|pamid_cli)", told), "it takes pamid from its face"
    for target in re.findall(r"\]\((pictures/[^)]+)\)", told):
        assert (story.parent / target).is_file(), target
    text = story.with_suffix(".ipynb").read_text(encoding="utf-8")
    assert text == notebook_text(story), "write it anew: python tests/support/stories.py"
    notebook = nbformat.reads(text, as_version=4)
    assert not [c for c in notebook.cells if c.cell_type == "code" and c.outputs]


@pytest.mark.slow
def test_a_notebook_runs_and_shows_cards_and_figures(tmp_path):
    notebook = nbformat.reads(notebook_text(STORIES[0]), as_version=4)
    NotebookClient(notebook, timeout=600, resources={"metadata": {"path": tmp_path}}).execute()
    shown = {
        kind
        for cell in notebook.cells
        for output in cell.get("outputs", [])
        for kind in output.get("data", {})
    }
    assert {"text/html", "image/png"} <= shown


@pytest.mark.parametrize("story", RUNS)
def test_story_runs(story, tmp_path):
    own = tmp_path / "tmp"
    own.mkdir()
    before = files_of_the_repository()
    settings = {
        **os.environ,
        "TMPDIR": str(own),
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
    }
    done = subprocess.run(
        [sys.executable, "-W", "error", str(story)],
        cwd=tmp_path,
        env=settings,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]
    assert done.stdout.strip()
    assert sorted(tmp_path.rglob("*")) == [own], "something was left behind"
    assert files_of_the_repository() == before, "something was written into the repository"
