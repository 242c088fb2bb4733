"""The documentation builds without a warning, has a page for everything there is, and loads nothing
from elsewhere; the pictures show what the effects do."""

import os
import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from pamid_cli.table import COMMANDS

from pamid.model.registry import effects, rigs

ROOT = Path(__file__).resolve().parents[2]
ABSENT = [name for name in ("mkdocs", "material", "mkdocstrings") if find_spec(name) is None]
needs_docs = pytest.mark.skipif(
    bool(ABSENT), reason=f"{', '.join(ABSENT)} not installed: pip install '.[docs]'"
)
#: what a browser loads by itself when it shows a page
LOADED = re.compile(
    r"<(?:script|img|iframe|source)[^>]*\ssrc=[\"']?([^\"'\s>]+)"
    r"|<link[^>]*\srel=[\"']?(?:stylesheet|preconnect|preload|icon)[^>]*\shref=[\"']?([^\"'\s>]+)"
)


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    """The site, without the pictures of the effects."""
    made = tmp_path_factory.mktemp("docs")
    clean = {"PAMID_DOCS_PICTURES": "0", "NO_MKDOCS_2_WARNING": "1", "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", made],
        cwd=ROOT,
        env={**os.environ, **clean},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return made


@needs_docs
def test_everything_there_is_has_a_page(site):
    wanted = [f"reference/effects/{name}" for name in effects()]
    wanted += [f"reference/rigs/{name}" for name in rigs()]
    wanted += [f"reference/commands/{name}" for name in COMMANDS]
    wanted += ["reference/rig-files", "reference/recordings", "reference/settings"]
    wanted += ["explanation/glossary"]
    assert [name for name in wanted if not (site / f"{name}.html").is_file()] == []
    face = (site / "reference" / "python.html").read_text(encoding="utf-8")
    assert "pamid.api.diagnosing.diagnose" in face


@needs_docs
def test_nothing_is_loaded_from_elsewhere(site):
    pages = sorted(site.rglob("*.html"))
    loaded = {
        one
        for page in pages
        for pair in LOADED.findall(page.read_text(encoding="utf-8"))
        for one in pair
        if one
    }
    assert pages and any(one.endswith(".css") for one in loaded)
    assert [one for one in loaded if re.match(r"(https?:)?//", one)] == []
    styles = "".join(p.read_text(encoding="utf-8") for p in site.rglob("*.css"))
    assert not re.findall(r"(?:@import|url\()\s*[\"']?(?:https?:)?//", styles)


def test_every_effect_has_a_machine_that_shows_it():
    from signatures import chosen_cases

    assert set(chosen_cases()) == set(effects())


def test_the_signature_of_friction_opposes_the_velocity():
    from signatures import chosen_cases, drawn, seen

    what = seen(chosen_cases()["coulomb-friction"])
    added, fast = what.after - what.before, np.abs(what.over) > 0.1 * np.abs(what.over).max()
    assert what.over_name == "velocity" and np.ptp(added) > 0.0
    assert np.mean(added[fast] * what.over[fast] < 0.0) > 0.95
    assert b"what enters" not in drawn(what) and drawn(what).startswith(b"<?xml")
