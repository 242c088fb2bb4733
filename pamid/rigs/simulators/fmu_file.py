"""Description of an FMU (FMI 2.0 or 3.0), read without running it. The package is FMPy, the extra
`[fmu]`.

    Modelica Association (2022), Functional Mock-up Interface for Model Exchange, Co-Simulation, and
    Scheduled Execution, version 3.0; (2014) version 2.0
"""

from __future__ import annotations

import re
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pamid.base.errors import FileError
from pamid.base.files import LOG, MIB, PathLike, open_data
from pamid.base.units import NONE, is_unit, named_with, si_symbol, unit
from pamid.rigs.simulators.fmu_choices import (
    CO_SIMULATION,
    EXCHANGE,
    FmuChoices,
    choices_path,
    read_choices,
)
from pamid.rigs.simulators.foreign_limits import RAISED, foreign_limits, require_few

MOST_NAMED_VARIABLES = 20  # variables that a remark lists by name
_DESCRIPTION = "modelDescription.xml"


@dataclass(frozen=True)
class FmuVariable:
    """A real variable.

    name    as a column or parameter, with its unit
    called  name in the FMU
    unit    unit in the FMU, "" if it has none or an unknown unit
    start   start value in this unit
    """

    name: str
    called: str
    reference: int
    unit: str
    start: float
    tunable: bool

    @property
    def si(self) -> str:
        return si_symbol(self.unit) if self.unit else ""

    @property
    def scale(self) -> tuple[float, float]:
        """Factor and offset from the unit in the FMU to SI."""
        read = unit(self.unit or NONE)
        return read.factor, read.offset


@dataclass(frozen=True)
class FmuFile:
    """An FMU with the options of its use.

    exchange    True for model exchange, False for co-simulation
    states, rates   continuous states and references of their derivatives, for model exchange
    nominals    typical sizes of states
    indicators  number of event indicators
    seen        True if the states are its whole memory
    saves       True if it can save its state
    alone       True if a process can hold only a single instance
    period_s    proposed step, 0 if it proposes none
    any_step    True if it takes steps of any length
    motion      inputs that are forces -> position and velocity there
    free        parameters to fit, if not all of them
    remarks     remarks on its use and on omissions
    """

    path: str
    name: str
    version: int
    exchange: bool
    inputs: tuple[FmuVariable, ...]
    outputs: tuple[FmuVariable, ...]
    parameters: tuple[FmuVariable, ...]
    states: tuple[FmuVariable, ...]
    rates: tuple[int, ...]
    nominals: tuple[float, ...]
    indicators: int
    seen: bool
    saves: bool
    alone: bool
    any_step: bool
    period_s: float
    identifier: str
    token: str
    motion: dict[str, tuple[str, str]]
    free: tuple[str, ...]
    remarks: tuple[str, ...]

    @property
    def request(self) -> dict[str, Any]:
        """Arguments of `pamid.rigs.simulators.fmu_host.serve`, except the folder."""
        groups = {
            name: getattr(self, name) for name in ("inputs", "outputs", "parameters", "states")
        }
        return {
            **vars(self),
            **{name: [v.reference for v in group] for name, group in groups.items()},
            "units": [[[v.scale[k] for v in group] for k in (0, 1)] for group in groups.values()],
            "called": [v.called for v in self.outputs],
            "tunable": [v.tunable for v in self.parameters],
        }


def fmpy_package() -> Any:
    """Return FMPy. FileError with the package to install if it is absent."""
    try:
        import fmpy
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] != "fmpy":
            raise
        raise FileError(
            "An FMU needs fmpy, which is not installed.",
            "pip install 'pamid[fmu]'",
            code="missing-extra",
        ) from error
    return fmpy


def read_fmu(path: PathLike) -> FmuFile:
    """Read the description of an FMU.

    Raises
    ------
    FileError
        The file is absent or damaged. It offers neither kind, or no binary for this machine. It has
        no real input or no real output. The extra is not installed.
    """
    file = Path(path)
    if not file.exists():
        raise FileError(f"no such file: {file}", "give the path of an .fmu file")
    fmpy = fmpy_package()
    try:
        _require_size(file)
        described = fmpy.read_model_description(str(file))
        platforms = fmpy.supported_platforms(str(file))
    except FileError:
        raise
    except Exception as error:  # FMPy passes on any error of zip and XML
        reason = " ".join(str(error).split())[:300]
        raise FileError(
            f"{file} cannot be read as an FMU: {reason or type(error).__name__}",
            "Check it with `fmpy validate`, and export it again.",
            code="model",
        ) from error
    version = int(str(described.fmiVersion)[:1])
    if version not in (2, 3) or not (described.coSimulation or described.modelExchange):
        raise FileError(
            f"{file} is an FMU of FMI {described.fmiVersion} without co-simulation or model "
            "exchange.",
            "Export it for one of them, FMI 2.0 or 3.0.",
            code="model",
        )
    own_platforms = {fmpy.platform, fmpy.platform_tuple}
    if not own_platforms & set(platforms):
        none = "no machine" + (": it holds sources" if platforms else " that is known here")
        there = ", ".join(p for p in platforms if p != "c-code") or none
        raise FileError(
            f"{file} has a binary for {there}, not for this one ({fmpy.platform}).",
            "Export it for this machine, or build it here with `fmpy compile`.",
            code="model",
        )
    return _file(file, version, described, read_choices(file))


def _file(file: Path, version: int, described: Any, chosen: FmuChoices) -> FmuFile:
    exchange, why = _kind(file, described, chosen)
    offers = described.modelExchange if exchange else described.coSimulation
    variables = described.modelVariables
    reals = [v for v in variables if v.type in ("Real", "Float64") and not v.shape]
    used_names: dict[str, int] = {}

    def of(causality: str) -> tuple[FmuVariable, ...]:
        return tuple(_variable(v, used_names) for v in reals if v.causality == causality)

    inputs, outputs, parameters = of("input"), of("output"), of("parameter")
    for what, group in (("input", inputs), ("output", outputs)):
        if not group:
            raise FileError(
                f"{file} has no {what} that is a real number.",
                f"Declare what is {'sent to' if what == 'input' else 'measured of'} it as {what}.",
                code="model",
            )
    require_few(file, "inputs and outputs", len(inputs) + len(outputs))
    rates = [d.variable for d in described.derivatives] if exchange else []
    known = {v.reference: v for v in outputs}
    derivatives = [r.derivative for r in rates]
    states = tuple(
        known.get(v.valueReference) or _variable(v, used_names)
        for v in derivatives
        if v is not None
    )
    saves = bool(offers.canGetAndSetFMUstate)
    # numbers that only events change are further memory; booleans follow from the states
    remembered = any(
        v.variability == "discrete"
        and v.type != "Boolean"
        and v.causality not in ("input", "parameter")
        for v in variables
    )
    is_whole = bool(derivatives) and None not in derivatives and not remembered
    seen = exchange and is_whole and chosen.seen is not False
    events = described.numberOfEventIndicators if version == 2 else len(described.eventIndicators)
    proposed = described.defaultExperiment and described.defaultExperiment.stepSize
    return FmuFile(
        str(file),
        _word(described.modelName or file.stem),
        version,
        exchange,
        inputs,
        outputs,
        parameters,
        states,
        tuple(int(v.valueReference) for v in rates),
        tuple(abs(float(v.nominal or 1.0)) for v in derivatives if v is not None),
        int(events or 0) if exchange else 0,
        seen,
        saves,
        bool(offers.canBeInstantiatedOnlyOncePerProcess),
        exchange or bool(offers.canHandleVariableCommunicationStepSize),
        float(proposed or 0.0),
        offers.modelIdentifier,
        described.instantiationToken,
        chosen.motion,
        chosen.free,
        (*why, *_remarks(variables, reals, exchange, seen, saves)),
    )


def _kind(file: Path, described: Any, chosen: FmuChoices) -> tuple[bool, list[str]]:
    """True for model exchange, with the reason if it offers both kinds."""
    other, has_exchange = described.coSimulation, described.modelExchange
    if chosen.kind:
        if not (has_exchange if chosen.kind == EXCHANGE else other):
            raise FileError(
                f"{chosen.path}: kind = {chosen.kind!r}, which {file} does not offer",
                f'it offers kind = "{EXCHANGE if has_exchange else CO_SIMULATION}"',
                code="model",
            )
        return chosen.kind == EXCHANGE, [f"used for {chosen.kind}, as {chosen.path.name} says"]
    if not (other and has_exchange):
        return has_exchange is not None, []
    if other.canGetAndSetFMUstate:
        exchange, reason = False, "it saves its state there, and brings its own solver"
    else:
        exchange, reason = True, "for co-simulation it saves no state"
    kind, rest = (EXCHANGE, CO_SIMULATION) if exchange else (CO_SIMULATION, EXCHANGE)
    choices_file = choices_path(file).name
    return exchange, [
        f"it offers both kinds, and is used for {kind}: {reason} "
        f'(kind = "{rest}" in {choices_file} takes the other)'
    ]


def _remarks(
    variables: list[Any],
    reals: list[Any],
    exchange: bool,
    seen: bool,
    saves: bool,
) -> list[str]:
    """Remarks on the use of the FMU."""
    known = set(map(id, reals))  # variables compare by all their attributes
    others = sorted(
        v.name
        for v in variables
        if id(v) not in known and v.causality in ("input", "output", "parameter")
    )
    lost = "" if seen or saves else "; it saves no states, so that a window is replayed from the "
    lost += "start" if lost else ""
    remarks = [
        f"{'integrated by pamid' if exchange else 'stepped by its own binary'}, "
        f"in a separate process{lost}"
    ]
    if exchange:
        remarks += [
            "state, time and step events are waited for, and handled in its event mode; clocks, "
            "and equations that want an implicit method, are not supported"
        ]
    if seen:
        remarks += ["its states are seen; their sensitivities are differences between copies"]
    else:
        remarks += [
            "its states are not seen: a fit runs it from the start of each recording, and which "
            "ports sensors can tell apart is not known"
        ]
    if len(others) > MOST_NAMED_VARIABLES:
        others = [*others[:MOST_NAMED_VARIABLES], f"and {len(others) - MOST_NAMED_VARIABLES} more"]
    return [*remarks, *([f"left out, as no real numbers: {', '.join(others)}"] if others else [])]


def _variable(v: Any, used_names: dict[str, int]) -> FmuVariable:
    """A variable of the description under an unused name.

    used_names: names, with the number of variables that requested each.
    """
    declared = v.unit or (v.declaredType.unit if v.declaredType else None) or ""
    symbol = declared.replace(".", " ")
    symbol = symbol if is_unit(symbol) and unit(symbol).symbol != NONE else ""
    name = named_with(_word(v.name), symbol) if symbol else _word(v.name)
    fresh = _fresh_name(name, used_names)
    start = v.start[0] if isinstance(v.start, list | tuple) else v.start
    return FmuVariable(
        fresh,
        v.name,
        int(v.valueReference),
        symbol,
        float(start or 0.0),
        v.variability == "tunable",
    )


def _fresh_name(name: str, used_names: dict[str, int]) -> str:
    """Unused name that resembles the given name: "x", "x_", "x_3", "x_4" ..."""
    fresh = name
    while fresh in used_names:
        used_names[name] += 1
        fresh = f"{name}_{used_names[name]}" if used_names[name] > 2 else f"{name}_"
    used_names[fresh] = 1
    return fresh


def _word(name: str) -> str:
    plain = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_")
    return plain if plain[:1].isalpha() else f"v_{plain}"


def _require_size(path: Path) -> None:
    """Raise FileError if an FMU is not a regular file, or larger than allowed.

    Nothing is unpacked for this test. A member beyond the length in its entry is cut off there.
    """
    limits = foreign_limits()
    with open_data(path, LOG) as file, zipfile.ZipFile(file) as packed:
        members = packed.infolist()
        total = sum(member.file_size for member in members)
        text = sum(member.file_size for member in members if member.filename == _DESCRIPTION)
    for count, most, words in (
        (len(members), limits.files, "it holds {} files, of an FMU at most {} are unpacked"),
        (total // MIB, limits.unpacked // MIB, "it unpacks to {} MiB, of an FMU at most {} MiB"),
        (
            text // MIB,
            limits.text // MIB,
            f"its {_DESCRIPTION} has {{}} MiB, at most {{}} are read",
        ),
    ):
        if count > most:
            raise FileError(f"{path}: {words.format(count, most)}.", RAISED, code="too-large")


def extracted(path: str, folder: str) -> None:
    """Unpack the FMU into a folder."""
    try:
        _require_size(Path(path))
        fmpy_package().extract(path, folder)
    except FileError:
        raise
    except Exception as error:
        raise FileError(
            f"{path} cannot be unpacked: {error}", "Export it again.", code="damaged"
        ) from error
