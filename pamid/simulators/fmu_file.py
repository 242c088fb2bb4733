"""What an FMU (FMI 2.0 or 3.0) says of itself; nothing of it is run to read that. The package is
FMPy, the extra `[fmu]`.

    Modelica Association (2022), Functional Mock-up Interface for Model Exchange, Co-Simulation, and
    Scheduled Execution, version 3.0; (2014) version 2.0
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pamid.base.errors import FileError
from pamid.base.files import PathLike
from pamid.base.units import NONE, is_unit, named_with, si_symbol, unit

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FmuVariable:
    """A real variable. name: as a column or parameter, with its unit; called: in the FMU; unit: the
    FMU's, "" where it has none that is known here; start: in this unit."""

    name: str
    called: str
    reference: int
    unit: str
    start: float
    tunable: bool = False
    about: str = ""

    @property
    def si(self) -> str:
        return si_symbol(self.unit) if self.unit else ""


@dataclass(frozen=True)
class FmuVariables:
    """Variables in a row, whose values are (n, variables)."""

    variables: tuple[FmuVariable, ...]
    scale: Array = field(init=False, compare=False)
    offset: Array = field(init=False, compare=False)

    def __post_init__(self) -> None:
        units = [unit(v.unit or NONE) for v in self.variables]
        object.__setattr__(self, "scale", np.array([u.factor for u in units]))
        object.__setattr__(self, "offset", np.array([u.offset for u in units]))

    @property
    def references(self) -> list[int]:
        return [v.reference for v in self.variables]

    def outside(self, values: Array) -> Array:
        """SI values in the FMU's units."""
        found: Array = (values - self.offset) / self.scale
        return found

    def inside(self, values: Array) -> Array:
        """Values in the FMU's units as SI."""
        found: Array = values * self.scale + self.offset
        return found


@dataclass(frozen=True)
class FmuFile:
    """An FMU for co-simulation. period_s: the step that it proposes, 0 where none; any_step: it
    takes steps of any length; remarks: what is left out."""

    path: str
    name: str
    version: int
    inputs: FmuVariables
    outputs: FmuVariables
    parameters: FmuVariables
    saves: bool
    any_step: bool
    period_s: float
    identifier: str
    token: str
    remarks: tuple[str, ...]

    @property
    def request(self) -> dict[str, Any]:
        """What `FmuHost` is made of, but for the folder."""
        return {
            "path": self.path,
            "version": self.version,
            "identifier": self.identifier,
            "token": self.token,
            "parameters": self.parameters.references,
            "tunable": [v.tunable for v in self.parameters.variables],
            "inputs": self.inputs.references,
            "outputs": self.outputs.references,
            "saves": self.saves,
        }


def fmpy_package(path: PathLike) -> Any:
    """FMPy; FileError with what to install where it is absent."""
    try:
        import fmpy
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] != "fmpy":
            raise
        raise FileError(
            f"{path}: an FMU needs fmpy, which is not installed.",
            "pip install 'pamid[fmu]'",
            code="missing-extra",
        ) from error
    return fmpy


def read_fmu(path: PathLike) -> FmuFile:
    """What the file says. FileError: it is absent or damaged, it has no co-simulation, no binary
    for this machine, no input or output that is a real number, or the extra is not installed."""
    file = Path(path)
    if not file.is_file():
        raise FileError(f"no such file: {file}", "give the path of an .fmu file")
    fmpy = fmpy_package(file)
    try:
        described = fmpy.read_model_description(str(file))
        platforms = fmpy.supported_platforms(str(file))
    except Exception as error:  # FMPy passes on whatever zip and XML raise
        said = " ".join(str(error).split())[:300]
        raise FileError(
            f"{file} cannot be read as an FMU: {said or type(error).__name__}",
            "Check it with `fmpy validate`, and export it again.",
            code="model",
        ) from error
    offers = described.coSimulation
    version = int(str(described.fmiVersion)[:1])
    if offers is None or version not in (2, 3):
        raise FileError(
            f"{file} is an FMU of FMI {described.fmiVersion} without co-simulation.",
            "Export it for co-simulation, FMI 2.0 or 3.0.",
            code="model",
        )
    here = {fmpy.platform, fmpy.platform_tuple}
    if not here & set(platforms):
        there = ", ".join(p for p in platforms if p != "c-code") or "no machine: it holds sources"
        raise FileError(
            f"{file} has a binary for {there}, not for this one ({fmpy.platform}).",
            "Export it for this machine, or build it here with `fmpy compile`.",
            code="model",
        )
    return _file(file, version, described, offers)


def _file(file: Path, version: int, described: Any, offers: Any) -> FmuFile:
    reals = [v for v in described.modelVariables if v.type in ("Real", "Float64") and not v.shape]
    others = sorted(
        v.name
        for v in described.modelVariables
        if v not in reals and v.causality in ("input", "output", "parameter")
    )
    taken: set[str] = set()

    def of(causality: str) -> FmuVariables:
        return FmuVariables(tuple(_variable(v, taken) for v in reals if v.causality == causality))

    inputs, outputs, parameters = of("input"), of("output"), of("parameter")
    for what, found in (("input", inputs), ("output", outputs)):
        if not found.variables:
            raise FileError(
                f"{file} has no {what} that is a real number.",
                f"Declare what is {'sent to' if what == 'input' else 'measured of'} it as {what}.",
                code="model",
            )
    proposed = described.defaultExperiment and described.defaultExperiment.stepSize
    saves = bool(offers.canGetAndSetFMUstate)
    remarks = [
        "stepped by its own binary, in a process of its own"
        + ("" if saves else "; it saves no states, so that a window is replayed from the start"),
        "its states are not seen: a fit runs it from the start of each recording, and which ports "
        "sensors can tell apart is not known",
    ]
    remarks += [f"left out, as no real numbers: {', '.join(others)}"] if others else []
    return FmuFile(
        str(file),
        _word(described.modelName or file.stem),
        version,
        inputs,
        outputs,
        parameters,
        saves,
        bool(offers.canHandleVariableCommunicationStepSize),
        float(proposed or 0.0),
        offers.modelIdentifier,
        described.instantiationToken,
        tuple(remarks),
    )


def _variable(v: Any, taken: set[str]) -> FmuVariable:
    declared = v.unit or (v.declaredType.unit if v.declaredType else None) or ""
    symbol = declared.replace(".", " ")
    symbol = symbol if is_unit(symbol) and unit(symbol).symbol != NONE else ""
    name = named_with(_word(v.name), symbol) if symbol else _word(v.name)
    while name in taken:
        name += "_"
    taken.add(name)
    start = v.start[0] if isinstance(v.start, list | tuple) else v.start
    return FmuVariable(
        name,
        v.name,
        int(v.valueReference),
        symbol,
        float(start or 0.0),
        v.variability == "tunable",
        v.description or "",
    )


def _word(name: str) -> str:
    plain = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_")
    return plain if plain[:1].isalpha() else f"v_{plain}"


def extracted(path: str, folder: str) -> None:
    """The FMU unpacked into a folder."""
    try:
        fmpy_package(path).extract(path, folder)
    except FileError:
        raise
    except Exception as error:
        raise FileError(
            f"{path} cannot be unpacked: {error}", "Export it again.", code="damaged"
        ) from error
