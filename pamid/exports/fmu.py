"""A sample step as a functional mock-up unit, FMI 2.0 or 3.0, for co-simulation.

It has C99 sources, and a binary for this machine. assets/fmu.h describes the work between two
communication points.
"""

from __future__ import annotations

import hashlib
import io
import platform
import re
import shutil
import subprocess
import tempfile
import zipfile
from dataclasses import dataclass
from pathlib import Path
from string import Template
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from pamid.base.progress import tell
from pamid.base.units import unit
from pamid.exports.c_source import asset, header, model_name, source
from pamid.exports.form import Written
from pamid.exports.step import SampleStep
from pamid.networks.correction.identified_model import Identified
from pamid.rigs.simulators.fmu_file import fmpy_package

_FLAGS = ("-shared", "-fPIC", "-std=c99", "-O2", "-Wall", "-Wextra")
_ENDINGS = {"linux": "so", "darwin": "dylib", "windows": "dll"}
_DIMENSIONS = ("kg", "m", "s", "A", "K", "rad")
_HOW_TO_BUILD = (
    "the FMU contains only sources: compile it on the target machine, with `fmpy compile`, "
    "Simulink's fmudialog.compileFMUSources or the compiler of the importing tool"
)


@dataclass(frozen=True)
class Fmu:
    """The file, and the folder of its binary or the reason why it has none."""

    data: bytes
    binary: str
    why: str


def write_fmu(
    model: Identified, step: SampleStep, files: tuple[Path, ...], *, version: int
) -> Written:
    fmu = make_fmu(step, version)
    notes = (f"{fmu.why}; {_HOW_TO_BUILD}",) if fmu.why else ()
    return Written({files[0]: fmu.data}, fmu.binary, notes)


def make_fmu(step: SampleStep, version: int, *, compiler: str | None = None) -> Fmu:
    """Build an FMU.

    Parameters
    ----------
    step
        Sample step of the model.
    version
        FMI 2 or 3.
    compiler
        C compiler; by default the first of cc, gcc, clang; "" for none.
    """
    name = model_name(step)
    model = {f"{name}.h": header(step), f"{name}.c": source(step)}
    token = hashlib.sha256("".join([str(version), *model.values()]).encode()).hexdigest()[:32]
    shared = Template(asset("fmu.h")).substitute(
        model=name,
        MODEL=name.upper(),
        token=token,
        starts=", ".join(repr(v.start) for v in step.inputs) or "0.0",
        parameter="c->m.p[k - NU - NY]" if step.parameters else "c->u[NU]",
    )
    shim = asset(f"fmi{version}.c")
    sources = {**model, "fmu.h": shared, f"fmi{version}.c": shim + not_offered(version, shim)}
    cc = (
        next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))), "")
        if compiler is None
        else compiler
    )
    folder, ending = _place(version)
    why = "no C compiler (cc, gcc or clang) was found" if not cc else ""
    why = why or ("" if folder else f"FMI {version}.0 does not define binaries for this machine")
    binary = b""
    if not why:
        tell("compiling")
        binary, why = _compiled(sources, version, cc)
    described = _description_2(step, sources) if version == 2 else _description_3(step, sources)
    content = {"modelDescription.xml": _xml(described)}
    content |= {f"sources/{name}": text.encode() for name, text in sources.items()}
    if version == 3:
        files = (_element("SourceFile", {"name": file}) for file in sources if file.endswith(".c"))
        content["sources/buildDescription.xml"] = _xml(_element(
            "fmiBuildDescription", {"fmiVersion": "3.0"},
            _element("BuildConfiguration", {"modelIdentifier": name},
                _element("SourceFileSet", {"language": "C99"}, *files)),
        ))  # fmt: skip
    if binary:
        content[f"binaries/{folder}/{name}.{ending}"] = binary
    # an archive whose bytes only depend on the content
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as packed:
        for place, data in content.items():
            entry = zipfile.ZipInfo(place)
            entry.compress_type, entry.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
            packed.writestr(entry, data)
    return Fmu(archive.getvalue(), folder if binary else "", why)


# ---- sources and binary ------------------------------------------------------------------------


def not_offered(version: int, shim: str) -> str:
    """Definitions of the standard's functions that the shim leaves out; they return an error."""
    lines = []
    header = (standard_headers() / f"fmi{version}FunctionTypes.h").read_text(encoding="utf-8")
    types = re.sub(r"/\*.*?\*/", "", header, flags=re.DOTALL)
    for kind, name, arguments in re.findall(
        r"typedef\s+(\w+)\s+(fmi\d\w+)TYPE\s*\(([^;]*)\);", types
    ):
        if not re.search(rf"\b{name}\(", shim):
            listed = " ".join(arguments.split())
            words = [re.findall(r"\w+", a)[-1] for a in listed.split(",")]
            failed = f"fmi{version}Error" if kind.endswith("Status") else "NULL"
            lines += [
                "",
                f"{kind} {name}({listed})",
                "{",
                *(f"    (void){w};" for w in words),
                f"    return {failed};",
                "}",
            ]
    return "\n".join([*lines, ""])


def standard_headers() -> Path:
    """Folder of the standard's C headers, which come with FMPy. FileError if it is absent."""
    return Path(fmpy_package().__file__).parent / "c-code"


def _place(version: int) -> tuple[str, str]:
    """Folder and ending of a binary for this machine; no folder if the standard has none."""
    system, machine = platform.system().lower(), platform.machine().lower()
    machine = {"amd64": "x86_64", "arm64": "aarch64", "i386": "x86", "i686": "x86"}.get(
        machine, machine
    )
    ending = _ENDINGS.get(system, "so")
    if version == 3:
        return f"{machine}-{system}", ending
    bits = {"x86_64": "64", "x86": "32"}.get(machine)
    short = {"linux": "linux", "darwin": "darwin", "windows": "win"}.get(system)
    return (f"{short}{bits}" if bits and short else "", ending)


def _compiled(sources: dict[str, str], version: int, compiler: str) -> tuple[bytes, str]:
    """The binary, or the reason why there is none."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for file, text in sources.items():
            (folder / file).write_text(text, encoding="utf-8")
        line = [
            compiler,
            *_FLAGS,
            f"-I{standard_headers()}",
            *(file for file in sources if file.endswith(".c")),
            "-lm",
            "-o",
            "model.bin",
        ]
        try:
            done = subprocess.run(line, cwd=folder, capture_output=True, text=True, timeout=300)
        except (OSError, subprocess.TimeoutExpired) as error:
            return b"", f"{compiler} could not be run: {error}"
        if done.returncode:
            return (
                b"",
                f"{compiler} failed: {(done.stderr.strip().splitlines() or ['no message'])[0]}",
            )
        return (folder / "model.bin").read_bytes(), ""


# ---- descriptions ------------------------------------------------------------------------------


def _xml(root: Element) -> bytes:
    ElementTree.indent(root)
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, "utf-8") + b"\n"


def _element(name: str, attributes: dict[str, str], *children: Element) -> Element:
    element = Element(name, attributes)
    element.extend(children)
    return element


def _root(
    step: SampleStep, sources: dict[str, str], version: int, *children: Element, **more: str
) -> Element:
    from importlib.metadata import version as version_of

    token = re.findall(r'TOKEN "(\w+)"', sources["fmu.h"])[0]
    about = {
        "fmiVersion": f"{version}.0",
        "modelName": step.name,
        {2: "guid", 3: "instantiationToken"}[version]: token,
        "description": f"Identified model of {step.name}, a step per {step.period_s!r} s",
        "generationTool": f"pamid {version_of('pamid')}",
        "variableNamingConvention": "flat",
        **more,
    }
    return _element("fmiModelDescription", about, *children)


def _units(step: SampleStep) -> Element:
    symbols = dict.fromkeys(
        v.unit for v in (*step.inputs, *step.outputs, *step.parameters) if v.unit
    )
    symbols |= {"s": None}
    units = []
    for symbol in symbols:
        kind = unit(symbol)
        base = {d: str(e) for d, e in zip(_DIMENSIONS, kind.dimension, strict=True) if e}
        base |= {"factor": repr(kind.factor)} if kind.factor != 1.0 else {}
        base |= {"offset": repr(kind.offset)} if kind.offset else {}
        units.append(_element("Unit", {"name": symbol}, _element("BaseUnit", base)))
    return _element("UnitDefinitions", {}, *units)


def _variables(step: SampleStep) -> list[tuple[dict[str, str], dict[str, str]]]:
    """Kind, unit and start of every variable, in the order of value references."""
    kinds = {"input": step.inputs, "output": step.outputs, "parameter": step.parameters}
    entries: list[tuple[dict[str, str], dict[str, str]]] = []
    for causality, variables in kinds.items():
        for v in variables:
            about = {
                "name": v.name,
                "valueReference": str(len(entries)),
                **({"description": v.about} if v.about else {}),
                "causality": causality,
                "variability": "continuous",
            }
            if causality == "parameter":
                about["variability"] = "fixed" if v.fixed else "tunable"
            if causality != "input":
                about["initial"] = "calculated" if causality == "output" else "exact"
            start = {} if causality == "output" else {"start": repr(v.start)}
            entries.append((about, {**({"unit": v.unit} if v.unit else {}), **start}))
    return entries


def _offers(step: SampleStep, state: str) -> dict[str, str]:
    return {
        "modelIdentifier": model_name(step),
        "canHandleVariableCommunicationStepSize": "true",
        f"canGetAndSet{state}": "true",
        f"canSerialize{state}": "true",
    }


def _description_2(step: SampleStep, sources: dict[str, str]) -> Element:
    offers = {**_offers(step, "FMUstate"), "canNotUseMemoryManagementFunctions": "true"}
    files = (_element("File", {"name": name}) for name in sources if name.endswith(".c"))
    structure = _structure(step)
    outputs = (
        {"index": str(k + 1), "dependencies": " ".join(str(i + 1) for i in needs)}
        for k, needs in structure
    )
    unknown = ({"index": str(k + 1)} for k, _ in structure)
    return _root(
        step, sources, 2,
        _element("CoSimulation", offers, _element("SourceFiles", {}, *files)),
        _units(step),
        _experiment(step),
        _element("ModelVariables", {}, *(
            _element("ScalarVariable", about, _element("Real", value))
            for about, value in _variables(step)
        )),
        _element("ModelStructure", {},
            _element("Outputs", {}, *(_element("Unknown", each) for each in outputs)),
            _element("InitialUnknowns", {}, *(_element("Unknown", each) for each in unknown)),
        ),
        numberOfEventIndicators="0",
    )  # fmt: skip


def _description_3(step: SampleStep, sources: dict[str, str]) -> Element:
    every, structure = _variables(step), _structure(step)
    clock = "time" if all(about["name"] != "time" for about, _ in every) else "time (independent)"
    time = {
        "name": clock,
        "valueReference": str(len(every)),
        "unit": "s",
        "causality": "independent",
        "variability": "continuous",
    }
    outputs = (
        {"valueReference": str(k), "dependencies": " ".join(map(str, needs))}
        for k, needs in structure
    )
    offers = {**_offers(step, "FMUState"), "fixedInternalStepSize": repr(step.period_s)}
    return _root(
        step, sources, 3,
        _element("CoSimulation", offers),
        _units(step),
        _experiment(step),
        _element("ModelVariables", {},
            *(_element("Float64", {**about, **value}) for about, value in every),
            _element("Float64", time),
        ),
        _element("ModelStructure", {},
            *(_element("Output", each) for each in outputs),
            *(_element("InitialUnknown", {"valueReference": str(k)}) for k, _ in structure),
        ),
    )  # fmt: skip


def _experiment(step: SampleStep) -> Element:
    return _element("DefaultExperiment", {"startTime": "0.0", "stepSize": repr(step.period_s)})


def _structure(step: SampleStep) -> list[tuple[int, list[int]]]:
    """Index of every output, and of the inputs that it directly depends on."""
    places = {v.name: i for i, v in enumerate(step.inputs)}
    return [
        (len(step.inputs) + i, [places[name] for name in needs])
        for i, needs in enumerate(step.feedthrough())
    ]
