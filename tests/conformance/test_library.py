"""Two look-ups, one for names from data and one for words of the user; and what is read of a file
is what runs."""

import importlib.util
import py_compile
import shutil
import sys
from pathlib import Path

import pytest

from pamid.base.errors import FileError
from pamid.base.files import sha256_of
from pamid.model import registry as library

CART = Path(__file__).resolve().parents[2] / "data" / "rigs" / "cart.py"


@pytest.mark.parametrize(
    "word", ["one-dof:{evil}", "{evil}", "./evil.py", "evil", "", "one-dof:", "../one-dof"]
)
def test_the_look_up_for_data_never_loads(word, here):
    for name in ("evil.py", "one-dof:evil.py"):
        (here / name).write_text("raise SystemExit('run')")
    if word == "one-dof:":
        assert library.catalogue_rig(word).name == "one-dof"
        return
    with pytest.raises(FileError):
        library.catalogue_rig(word.format(evil=here / "evil.py"))


def test_what_was_read_is_what_runs(tmp_path):
    """A compiled copy planted beside a rig file was once run instead of what can be read there."""
    path, marker = tmp_path / "cart.py", tmp_path / "ran"
    shutil.copy(CART, path)
    (tmp_path / "other.py").write_text(f"open({str(marker)!r}, 'w')\n")
    copy_of = importlib.util.cache_from_source(str(path))
    py_compile.compile(
        str(tmp_path / "other.py"),
        cfile=copy_of,
        invalidation_mode=py_compile.PycInvalidationMode.UNCHECKED_HASH,
    )
    assert library.rig_named(str(path)).name == "cart" and not marker.exists()
    assert not [name for name in sys.modules if name == "cart"]


def test_a_file_that_is_named_again_is_read_once(tmp_path, monkeypatch):
    """What is checked is what is run: were it read twice, it could be exchanged between."""
    path = tmp_path / "cart.py"
    shutil.copy(CART, path)
    noted, seen = {"cart.py": sha256_of(path)}, []
    real = Path.read_bytes

    def read(self):
        seen.append(self)
        content = real(self)
        self.write_text("raise SystemExit('exchanged')")
        return content

    monkeypatch.setattr(Path, "read_bytes", read)
    assert library.noted_rig("cart.py", str(path), noted).name == "cart" and seen == [path]
    with pytest.raises(FileError, match="SHA-256 differs"):
        library.noted_rig("cart.py", str(path), noted)
