"""Copying a run folder: file by file what its run has written, and nothing else."""

from __future__ import annotations

from pathlib import Path, PurePath

from pamid.base.errors import FileError
from pamid.base.files import TABLE, is_inside, read_data, write_atomically
from pamid.base.json_file import write_json
from pamid.base.run_folder import Run


def save_run(source: Path, target: Path, *, overwrite: bool = False) -> Path:
    """Copy the run in `source` to `target`: its record (run.json) and every file that the record
    lists, byte by byte. FileError where `target` is taken, or a file would lead out of `source`.
    """
    if target.resolve() == source.resolve():
        return target
    record = Run.open(source).record
    listed = record.get("files")
    names = [name for name in listed if isinstance(name, str)] if isinstance(listed, list) else []
    content = {name: _content(source, name) for name in names if (source / name).exists()}
    copy = Run.create(
        target,
        command=record.get("command") or "pamid",
        seed=record.get("seed"),
        options=record["options"],
        overwrite=overwrite,
    )
    for name, path in zip(content, copy.claim(*content), strict=True):
        write_atomically(path, content[name])
    write_json(target / "run.json", {**record, "files": list(content)})
    return target


def _content(folder: Path, name: str) -> bytes:
    path = folder / name
    if PurePath(name).is_absolute() or not is_inside(folder, PurePath(name)) or path.is_symlink():
        raise FileError(
            f"{folder / 'run.json'} lists {name!r}, which is not a file of that folder.",
            "Take it out of the list, or copy the folder by hand.",
            code="run-folder",
        )
    return read_data(path, TABLE)
