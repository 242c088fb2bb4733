"""Registry of effects and rigs: found by scanning their folders, or loaded from a user's file.

Two look-ups decide which code may run. `catalogue_rig` is for names from data, and never loads a
file. `rig_named` (`effects_with`) is for words of the user, where a path is Python code and is run.
"""

from __future__ import annotations

import hashlib
import importlib.machinery
import importlib.util
import os
import re
import sys
import traceback
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import TypeAlias

from pamid.base.errors import FileError, PamidError, UsageError, nearest, quoted
from pamid.base.files import PathLike
from pamid.base.scanned import classes_of, modules_of
from pamid.base.trust import is_code
from pamid.engine.symbolic.vocabulary import FUNCTIONS
from pamid.model.effect import Effect, require_sound
from pamid.model.free_form import FreeFormEffect
from pamid.model.rig import Rig, check_rig
from pamid.recording.recording import Recording

#: a name of the catalogue, the path of a rig file (it is run), or a rig
RigLike: TypeAlias = PathLike | Rig | type[Rig]

_RUNS_CODE = "A rig or effect file is code, run only when you name it yourself:"
_IN_PROGRAM = (
    "class:"  # leads the name that a run notes for a rig that no name and no file stands for
)


@lru_cache
def _scanned(package: str, base: type) -> dict[str, type]:
    modules = modules_of(package).values()
    return {cls.name: cls for module in modules for cls in classes_of(module, base)}


def effects() -> dict[str, type[Effect]]:
    """Every effect of the catalogue by name; the free forms are none."""
    return dict(_scanned("pamid.effects", Effect))


def free_form_effects() -> dict[str, type[FreeFormEffect]]:
    """The free forms of the families by name."""
    return dict(_scanned("pamid.effects.free_forms", FreeFormEffect))


def all_effects() -> dict[str, type[Effect]]:
    """All effects of the catalogue and the free forms."""
    return effects() | free_form_effects()


def rigs() -> dict[str, type[Rig]]:
    """Every rig of the catalogue by name."""
    return dict(_scanned("pamid.rigs", Rig))


@lru_cache
def model_readers() -> dict[str, Callable[[Path], Rig]]:
    """Function that makes a rig of a model file, by the ending of the file. The file does not run.

    They are the functions `rig` of the files in `pamid.rigs.simulators.kinds`, whose SUFFIXES
    `pamid.base.trust.MODEL_ENDINGS` has to know, too.
    """
    modules = modules_of("pamid.rigs.simulators.kinds").values()
    return {suffix: module.rig for module in modules for suffix in module.SUFFIXES}


def load_file(path: Path, sha256: str = "") -> ModuleType:
    """Run a user's Python file and return it as a module; errors name the file and the line.

    The file is read once and what was read is run: no compiled copy next to it (`__pycache__`),
    which may be another's, and no other content than the content of this SHA-256, if it is given.
    """
    if not path.is_file():
        raise FileError(
            f"no such file: {path}",
            "give a name from pamid rigs / pamid effects, or a path to a .py file",
        )
    if path.suffix != ".py":
        raise FileError(f"{path} is not a Python file", "a rig or effect file ends in .py")
    return _run(path, _source_of(path, sha256))


def _source_of(path: Path, sha256: str) -> bytes:
    """Content of a file; FileError where its SHA-256 is another than the given digest, if any."""
    try:
        source = path.read_bytes()
    except OSError as error:
        raise FileError(f"{path} cannot be read: {error.strerror}.") from error
    if sha256 and hashlib.sha256(source).hexdigest() != sha256:
        raise FileError(
            f"{path} is not the {path.name} that the run was made with: its SHA-256 differs.",
            "Restore the old file, or make the run again.",
            code="changed",
        )
    return source


def _run(path: Path, source: bytes) -> ModuleType:
    name = f"pamid_user_{hashlib.sha256(str(path.resolve()).encode()).hexdigest()[:12]}"
    loader = importlib.machinery.SourceFileLoader(name, str(path))
    spec = importlib.util.spec_from_file_location(name, path, loader=loader)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        exec(loader.source_to_code(source, str(path)), module.__dict__)
    except PamidError as error:
        raise FileError(f"{path}: {error.message}", error.hint) from error
    except SyntaxError as error:
        raise FileError(
            f"{path}, line {error.lineno}: {error.msg}", "Correct the Python syntax."
        ) from error
    except Exception as error:
        frames = reversed([*traceback.walk_tb(error.__traceback__)])
        line = next((n for frame, n in frames if frame.f_code.co_filename == str(path)), 0)
        inner = isinstance(error, ImportError) and (error.name or "").split(".")[0] == "pamid"
        hint = (
            "Import classes from `pamid` and functions from `pamid.equations` "
            f"({', '.join(FUNCTIONS)}); other modules may change."
            if inner
            else "Correct that line."
        )
        raise FileError(f"{path}, line {line}: {type(error).__name__}: {error}", hint) from error
    return module


def resolved_rig(rig: RigLike | None) -> str | Rig | None:
    """A word for `rig_named`, or the rig itself; UsageError for anything else."""
    if isinstance(rig, type) and issubclass(rig, Rig):
        return rig()
    if rig is None or isinstance(rig, str | Rig):
        return rig
    if isinstance(rig, os.PathLike):
        return as_file(rig)
    raise UsageError(
        f"rig={rig!r:.60} is not a rig.",
        "Give a name (see `pamid rigs`), the path of a rig file, or a pamid.Rig.",
    )


def rig_named(name: str | Rig) -> Rig:
    """The rig that a user named: of the catalogue, or by the path of a file that holds a rig,
    which is run, or of a model file, which is read; a rig itself stands for itself."""
    if isinstance(name, Rig):
        check_rig(name, type(name).__name__)
        return name
    return _rig_in(Path(name)) if is_code(name) else catalogue_rig(name)


def name_of(rig: str | Rig) -> str:
    """Name by which a run notes the rig that a user named: the word itself, the catalogue's name of
    a rig of the catalogue, else the name of its class."""
    if isinstance(rig, str):
        return rig
    kind = type(rig)
    if rigs().get(rig.name) is kind:
        variants = {f"{rig.name}:{v}": kind(v) for v in getattr(kind, "variants", ())}  # type: ignore[call-arg]
        for name, variant in {rig.name: kind(), **variants}.items():
            if vars(variant) == vars(rig):
                return name
    return f"{_IN_PROGRAM}{kind.__qualname__}"


def in_catalogue(name: str) -> bool:
    """Whether this word names a rig of the catalogue, or a variant of it. No file is run for
    it."""
    return name.partition(":")[0] in rigs()


def _rig_file_in(name: str) -> str:
    """A rig file of that name in the folder, which is named by its path."""
    file = Path(f"{name}.py")
    there = name.isidentifier() and file.is_file()
    return f"The file {file} is named by its path: ./{file}" if there else ""


def catalogue_rig(name: str) -> Rig:
    """A rig of the catalogue, "one-dof" or "one-dof:polynomial"; FileError for anything else. No
    file is ever run: this is the look-up for names that came from data."""
    if name.startswith(_IN_PROGRAM):
        raise FileError(
            f"{name.removeprefix(_IN_PROGRAM)} is a rig class of a Python program, not of the "
            "catalogue.",
            "Pass the class again in Python with rig=.",
            code="rig",
        )
    base, _, variant = name.partition(":")
    known = rigs()
    if base not in known:
        if is_code(name):
            raise FileError(f"{name!r} is a rig file.", f"{_RUNS_CODE} add --rig FILE.", code="rig")
        raise FileError(
            f"unknown rig {base!r}",
            _rig_file_in(base)
            or nearest(base, list(known))
            or f"rigs: {', '.join(known)}; or the path of a rig file",
        )
    if not variant:
        return known[base]()
    choices = getattr(known[base], "variants", ())
    if variant not in choices:
        raise FileError(
            f"rig {base!r} has no variant {variant!r}",
            nearest(variant, list(choices)) or f"variants: {', '.join(choices) or 'none'}",
        )
    return known[base](variant)  # type: ignore[call-arg]


def _rig_in(path: Path, sha256: str = "") -> Rig:
    if read := model_readers().get(path.suffix):
        if sha256:
            _source_of(path, sha256)
        model = read(path)
        check_rig(model, str(path))
        return model
    kinds = classes_of(load_file(path, sha256), Rig)
    if not kinds:
        raise FileError(f"{path} contains no rig.", "Define a class that derives from pamid.Rig.")
    if len(kinds) > 1:
        raise FileError(
            f"{path} holds {len(kinds)} rigs: {', '.join(c.__name__ for c in kinds)}",
            "keep a single rig in each file",
        )
    rig: Rig = kinds[0]()
    check_rig(rig, str(path))
    return rig


def noted_rig(noted: str, named: str | Rig | None, sha256: Mapping[str, str]) -> Rig:
    """The rig that a run notes; its file only where the caller names it, too, and it is the same as
    then; a rig of a program only where the caller gives it.

    sha256: of the run's inputs, by path.
    """
    if isinstance(named, Rig):
        return rig_named(named)
    if is_code(noted) and not is_code(named or ""):
        raise FileError(
            f"The run was made with the rig file {noted!r}.",
            f"{_RUNS_CODE} add --rig {quoted(noted)}",
            code="rig",
        )
    if named is None or not is_code(named):
        return catalogue_rig(named or noted)
    return _rig_in(Path(named), sha256.get(noted, ""))


def noted_effects(
    noted: tuple[str, ...], named: tuple[str | type[Effect], ...], sha256: Mapping[str, str]
) -> dict[str, type[Effect]]:
    """The catalogue, widened by the effect files that a run notes, each named again and the same as
    then, and by effects that are given themselves."""
    files = {Path(_file_of(name)).name: name for name in named if isinstance(name, str)}
    wanted: dict[str, str] = {}
    for path in filter(is_code, (_file_of(spec) for spec in noted)):
        if Path(path).name not in files:
            raise FileError(
                f"The run was made with the effect file {path!r}.",
                f"{_RUNS_CODE} add --effect {quoted(path)}",
                code="effect",
            )
        wanted[files[Path(path).name]] = sha256.get(path, "")
    return all_effects() | effects_with(named, wanted)[0]


def code_files(rig: str | Rig | None, specs: Sequence[str | type[Effect]]) -> list[Path]:
    """The rig and effect files among the user's words."""
    names = [rig, *(_file_of(spec) for spec in specs if isinstance(spec, str))]
    return [Path(name) for name in names if isinstance(name, str) and is_code(name)]


def _file_of(spec: str) -> str:
    """The path before an effect's @port and :parameters."""
    head, sep, _ = spec.partition(".py")
    return head + sep


def rig_of(recordings: list[Recording]) -> str:
    """The rig that the recordings' TOML files name; where they name none, the usual rig of the
    catalogue (`Rig.usual`).

    Only names of the catalogue: a rig file is code, and naming it in a data file must not run it
    (FileError).
    """
    named = {r.rig: r for r in recordings if r.rig}
    if len(named) > 1:
        raise FileError(
            f"the recordings name different rigs: {', '.join(sorted(named))}.",
            "Name the rig with --rig.",
        )
    for name, recording in named.items():
        if is_code(name):
            raise FileError(
                f"{recording.path} names the rig file {name!r}",
                f"{_RUNS_CODE} add --rig {quoted(name)}",
            )
        return name
    return next(name for name, kind in rigs().items() if vars(kind).get("usual"))


def effects_with(
    specs: tuple[str | type[Effect], ...], sha256: Mapping[str, str] = MappingProxyType({})
) -> tuple[dict[str, type[Effect]], list[str]]:
    """The catalogue, widened by the effects and the free forms among `specs` and by the effect
    files, which a user named and which are run; and the specs as names. sha256: what files have to
    be, by spec."""
    known, names = effects(), []
    for spec in specs:
        if isinstance(spec, type):
            require_sound(spec, spec.__name__)
            known[spec.name] = spec
            names.append(spec.name)
            continue
        path = _file_of(spec)
        if is_code(path):
            kinds = classes_of(load_file(Path(path), sha256.get(spec, "")), Effect)
            if not kinds:
                raise FileError(
                    f"{path} holds no effect", "an effect is a class that derives from pamid.Effect"
                )
            for cls in kinds:
                require_sound(cls, path)  # type: ignore[arg-type]
                known[cls.name] = cls  # type: ignore[attr-defined]
            names.append(kinds[0].name + spec.removeprefix(path))  # type: ignore[attr-defined]
        else:
            free = free_form_effects()
            known |= {n: free[n] for n in free if n == re.split("[@:]", spec, maxsplit=1)[0]}
            names.append(spec)
    return known, names


def as_file(path: os.PathLike[str]) -> str:
    """A path as a word that is taken for a file's, whatever it holds."""
    text = os.fspath(path)
    return text if is_code(text) else os.path.join(".", text)
