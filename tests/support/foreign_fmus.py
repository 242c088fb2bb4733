"""FMUs that pamid did not write: the slider in C of `tests/fmus`, compiled for this machine."""

import shutil
import subprocess
import zipfile
from collections.abc import Callable
from pathlib import Path

SOURCES = Path(__file__).resolve().parents[1] / "fmus"
FAULTS = ("CRASH", "HANG", "REFUSE", "NONSENSE")

#: of the slider's parameters, SI
TRUE = {
    "mass_kg": 2.0,
    "stiffness_n_per_m": 80.0,
    "damping_n_s_per_m": 3.0,
    "stop_m": 0.12,
    "stop_stiffness_n_per_m": 4000.0,
}

UNITS = dict(zip(TRUE, ("kg", "N/m", "N.s/m", "m", "N/m"), strict=True))


def compiler() -> str | None:
    """The C compiler at hand, None where there is none."""
    return shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")


def slider(
    folder: Path,
    version: int,
    *,
    kinds: tuple[str, ...] = ("CoSimulation", "ModelExchange"),
    saves: bool = True,
    derives: bool = True,
    sampled: bool = False,
    fault: str = "",
    name: str = "slider",
) -> Path:
    """The FMU in a folder. kinds: those that it offers; saves: it can save its state; derives: it
    gives directional derivatives; sampled: a time event every 0.05 s; fault: of FAULTS."""
    import fmpy

    library = folder / f"{name}{fmpy.sharedLibraryExtension}"
    flags = ["-DSAMPLED"] * sampled + [f"-DFAULT={fault}"] * bool(fault)
    headers = Path(fmpy.__file__).parent / "c-code"
    source = SOURCES / f"slider_fmi{version}.c"
    called = compiler()
    assert called is not None, "there is no C compiler"
    subprocess.run(
        [
            *(called, "-std=c99", "-O2", "-Wall", "-shared", "-fPIC", "-fvisibility=hidden"),
            *(*flags, f"-I{headers}", str(source), "-o", str(library), "-lm"),
        ],
        check=True,
    )
    path = folder / f"{name}.fmu"
    where = fmpy.platform if version == 2 else fmpy.platform_tuple
    with zipfile.ZipFile(path, "w") as packed:
        packed.writestr("modelDescription.xml", _described(version, kinds, saves, derives, sampled))
        packed.write(library, f"binaries/{where}/slider{fmpy.sharedLibraryExtension}")
    library.unlink()
    return path


def _described(
    version: int, kinds: tuple[str, ...], saves: bool, derives: bool, sampled: bool
) -> str:
    flag = {True: "true", False: "false"}
    state, slope = (
        ("canGetAndSetFMUstate", "providesDirectionalDerivative")
        if version == 2
        else ("canGetAndSetFMUState", "providesDirectionalDerivatives")
    )
    offers = "".join(
        f'<{kind} modelIdentifier="slider" {state}="{flag[saves]}" {slope}="{flag[derives]}"'
        + (' canHandleVariableCommunicationStepSize="true"' if kind == "CoSimulation" else "")
        + "/>"
        for kind in reversed(kinds)
    )
    rows: list[tuple[str, str, str, str, str]] = [
        ("force_n", "N", "input", "continuous", "0"),
        ("position_m", "m", "output", "continuous", "0"),
        ("speed_m_per_s", "m/s", "output", "continuous", "0"),
        ("der_position", "m/s", "local", "continuous", ""),
        ("der_speed", "m/s2", "local", "continuous", ""),
        *(
            (q, UNITS[q], "parameter", "tunable" if q.startswith("damping") else "fixed", str(v))
            for q, v in TRUE.items()
        ),
    ]
    rows += [("held_n", "N", "local", "discrete", "")] * sampled
    body = "".join(_variable(version, i + 1, *row) for i, row in enumerate(rows))
    units = "".join(f'<Unit name="{u}"/>' for u in sorted({row[1] for row in rows}))
    offers += f"<UnitDefinitions>{units}</UnitDefinitions>"
    head = '<?xml version="1.0" encoding="UTF-8"?>\n<fmiModelDescription '
    if version == 2:
        return (
            f'{head}fmiVersion="2.0" modelName="slider" guid="{{slider}}" '
            f'numberOfEventIndicators="1">{offers}<ModelVariables>{body}</ModelVariables>'
            '<ModelStructure><Outputs><Unknown index="2"/><Unknown index="3"/></Outputs>'
            '<Derivatives><Unknown index="4"/><Unknown index="5"/></Derivatives>'
            '<InitialUnknowns><Unknown index="4"/><Unknown index="5"/></InitialUnknowns>'
            "</ModelStructure></fmiModelDescription>"
        )
    crossing = '<Float64 name="crossing" valueReference="20" variability="continuous"/>'
    return (
        f'{head}fmiVersion="3.0" modelName="slider" instantiationToken="{{slider}}">{offers}'
        '<ModelVariables><Float64 name="time" valueReference="0" causality="independent" '
        f'variability="continuous"/>{body}{crossing}</ModelVariables><ModelStructure>'
        '<Output valueReference="2"/><Output valueReference="3"/>'
        '<ContinuousStateDerivative valueReference="4"/>'
        '<ContinuousStateDerivative valueReference="5"/>'
        '<InitialUnknown valueReference="4"/><InitialUnknown valueReference="5"/>'
        '<EventIndicator valueReference="20"/></ModelStructure></fmiModelDescription>'
    )


def _variable(
    version: int, place: int, name: str, unit: str, causality: str, variability: str, start: str
) -> str:
    initial = ' initial="exact"' if causality in ("output", "parameter") else ""
    of = {"der_position": 2, "der_speed": 3}.get(name)
    inside = (f' unit="{unit}"' if unit else "") + (f' start="{start}"' if start else "")
    inside += f' derivative="{of}"' if of else ""
    about = (
        f'name="{name}" valueReference="{place}" causality="{causality}" '
        f'variability="{variability}"{initial}'
    )
    if version == 2:
        return f"<ScalarVariable {about}><Real{inside}/></ScalarVariable>"
    return f"<Float64 {about}{inside}/>"


def changed(
    fmu: Path, folder: Path, change: Callable[[str, bytes], tuple[str, bytes] | None]
) -> Path:
    """A copy in this folder whose entries are what `change(name, data)` makes of them; None leaves
    one out."""
    path = folder / "changed.fmu"
    with zipfile.ZipFile(fmu) as old, zipfile.ZipFile(path, "w") as new:
        for name in old.namelist():
            found = change(name, old.read(name))
            if found is not None:
                new.writestr(*found)
    return path
