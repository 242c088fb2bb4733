"""LLVM IR to addresses of machine code, through a cache on disk.

The cache holds object files named by the sha256 of all their inputs, each led by a digest. A
file that is damaged, half-written or from another machine is compiled again, never loaded. Deleting
the folder is always safe, and two processes may share it (files are replaced whole).

Loaded code runs, and its digest is no protection against another author. Folder and file must
not be links, must belong to the user or root, and must be writable by nobody else. Otherwise models
are compiled in memory, which costs time and nothing else.
"""

from __future__ import annotations

import hashlib
import logging
import os
import stat
import tempfile
import threading
from contextlib import suppress
from functools import lru_cache
from pathlib import Path

import llvmlite
import llvmlite.binding as llvm

from pamid.base.trust import is_shared
from pamid.engine.cache_folder import home_cache, private_folder
from pamid.engine.llvm_ir import IN_PARTS

_VERSION = "2"
_lock = threading.Lock()
_loaded: dict[str, llvm.ExecutionEngine] = {}


def cache_folder() -> Path:
    """Folder of compiled models: $PAMID_CACHE, else in the user's cache folder, or in a
    private folder of this process where there is no home."""
    chosen = os.environ.get("PAMID_CACHE")
    return Path(chosen) if chosen else (home_cache() or private_folder()) / "pamid"


def _machine(level: int, **options: str) -> llvm.TargetMachine:
    """Target of machine code for this processor with this optimisation level (0 to 3)."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    return llvm.Target.from_default_triple().create_target_machine(
        cpu=llvm.get_host_cpu_name(),
        features=llvm.get_host_cpu_features().flatten(),
        opt=level,
        codemodel="jitdefault",
        jit=True,
        **options,
    )


def _key(ir_text: str) -> str:
    what = "\n".join(
        [
            _VERSION,
            llvmlite.__version__,
            llvm.get_default_triple(),
            llvm.get_host_cpu_name(),
            llvm.get_host_cpu_features().flatten(),
            ir_text,
        ]
    )
    return hashlib.sha256(what.encode()).hexdigest()


def _compile(ir_text: str) -> bytes:
    # common subexpressions are found before; of 14000 to 40000 straight lines (an arm of seven
    # joints) the first level of code alone takes 8 to 16 times as long as what is written at once,
    # and runs by a fifth faster at best
    long = ir_text.startswith(IN_PARTS)
    machine = _machine(0 if long else 2, reloc="pic")
    module = llvm.parse_assembly(ir_text)
    module.verify()
    if not long:
        options = llvm.create_pipeline_tuning_options(speed_level=2)
        builder = llvm.create_pass_builder(machine, options)
        builder.getModulePassManager().run(module, builder)
    return bytes(machine.emit_object(module))


def _read(path: Path) -> bytes | None:
    """The code in a file of the cache; None where there is none that can be believed."""
    try:
        _require_private(path.parent)
        # the open file is checked and read, whatever becomes of its name meanwhile; a pipe must not
        # block
        flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK
        with os.fdopen(os.open(path, flags), "rb") as file:
            status = os.fstat(file.fileno())
            if is_shared(status) or not stat.S_ISREG(status.st_mode):
                return None
            data = file.read()
    except OSError:
        return None
    return data[32:] if hashlib.sha256(data[32:]).digest() == data[:32] else None


def _require_private(folder: Path) -> None:
    """PermissionError for a folder that others may write, or for a link in its place."""
    status = folder.lstat()
    if is_shared(status) or not stat.S_ISDIR(status.st_mode):
        _say_once(folder)
        raise PermissionError(f"{folder} is not the user's alone")


@lru_cache
def _say_once(folder: Path) -> None:
    logging.getLogger("pamid").debug(
        "%s is not the user's alone: models are compiled in memory", folder
    )


def _write(path: Path, code: bytes) -> None:
    """Best effort: a cache that cannot be written, or is not the user's alone, costs time, nothing
    else."""
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        _require_private(path.parent)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=".new-")
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(hashlib.sha256(code).digest() + code)
            # In a single step, so that another process reads either the old file or the whole new
            # file.
            os.replace(name, path)
        except OSError:
            with suppress(OSError):
                os.unlink(name)


def addresses(ir_text: str, names: list[str]) -> list[int]:
    """Addresses of the named functions of a module given as text; compiled, or taken from the
    cache."""
    # The processor is part of the key: a cache in a shared home serves machines with other
    # instructions.
    key = _key(ir_text)
    # Two threads that want the same model compile it once.
    with _lock:
        engine = _loaded.get(key)
        if engine is None:
            path = cache_folder() / "models" / f"{key}.o"
            code = _read(path)
            if code is None:
                code = _compile(ir_text)
                _write(path, code)
            machine = _machine(2)
            engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
            engine.add_object_file(llvm.ObjectFileRef.from_data(code))
            engine.finalize_object()
            # The engine owns the machine code, which must stay as long as an address may be called.
            _loaded[key] = engine
        return [int(engine.get_function_address(name)) for name in names]
