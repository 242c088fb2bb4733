"""`pamid demo`: Run the whole workflow on a virtual rig, in about a minute."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pamid.api.options.record import (
    FolderPath,
    RigName,
    jobs_option,
    option,
    seed_option,
)
from pamid.base.errors import quoted

from . import frame
from .hints import unused
from .terminal import aside, progress_line

HELP_ORDER = 190
EXAMPLE = """
pamid demo --output demo-run --seed 1
"""
_BEGUN = (
    "Recording a virtual joint with a hidden fault, then fit, diagnosis, training of a network and "
    "report: about a minute."
)
_BEGUN_OTHER = "Recording a virtual machine with a hidden fault, then fit, diagnosis and report."


@dataclass(frozen=True)
class Arguments:
    """Build a virtual joint with a hidden effect and wrong parameters, record and diagnose it,
    train a network on the residual, write the report, and compare the diagnosis with the truth.

    With --rig the machine is built from that rig, as in `pamid trial`, and no network is trained.
    The hidden effect is drawn from all effects that fit its ports, and may be too small to show.
    """

    output: FolderPath = option("demo-run", "Run folder to create.")
    rig: RigName = option(
        "one-dof",
        "Rig of the virtual machine, by name or by the path of a rig file (it is run).",
    )
    seed: int = seed_option("Seed of the hidden fault, the excitation and the noise.", 1)
    jobs: int = jobs_option("Threads to use.")
    duration: float = option(
        60.0,
        "Length of the recording of the one-dof in s. The hold times of another rig determine its "
        "length.",
        least=15.0,
        most=3600.0,
    )
    overwrite: bool = option(False, "Replace an earlier run in that folder.")


@frame.command("demo", Arguments, example=EXAMPLE)
def command(arguments: Arguments) -> frame.Result:
    a, output = arguments, Path(arguments.output)
    # before the imports, which take seconds
    aside(_BEGUN if a.rig == "one-dof" else _BEGUN_OTHER)
    from pamid.api.replications.demonstration import run_demo
    from pamid.base.run_folder import Run
    from pamid.model.registry import code_files

    run = Run.create(
        output,
        command=frame.command_line(),
        seed=a.seed,
        inputs=code_files(a.rig, ()),
        overwrite=a.overwrite,
        options={
            "jobs": a.jobs,
            **({"duration_s": a.duration} if a.rig == "one-dof" else {"rig": a.rig}),
        },
    )
    with progress_line("demo") as progress:
        result = run_demo(
            run,
            seed=a.seed,
            jobs=a.jobs,
            duration_s=a.duration,
            rig=a.rig,
            progress=progress.say,
        )
    return frame.Result(result, demo_text(result, output))


def demo_text(result: dict[str, Any], output: Path) -> str:
    """Withheld effect and diagnosed cause, as text."""
    truth = result["withheld"]
    judged = {
        "right": "Right: the family of the withheld effect is named.",
        "among": "Partly right: the family of the withheld effect is among those named.",
        "missed": "Missed: the family of the withheld effect was not named.",
    }[result["hit"]]
    lines = [
        f"Withheld  {truth['effect']} ({truth['family']}): {', '.join(truth['as_simulated'])}",
        f"Named     {result['sentence']}",
    ]
    for cause in result["causes"]:
        values = ", ".join(  # an interval of no width is stated by its grade
            f"{k} {v['value']:.4g} "
            + (f"({v['low']:.4g} .. {v['high']:.4g})" if v["low"] < v["high"] else f"({v['word']})")
            for k, v in cause["parameters"].items()
        )
        lines.append(f"          {cause['effect']} ({cause['family']}): {values}")
    lines += [
        judged,
        "",
        f"{'parameter':30s} {'data sheet':>12s} {'true value':>12s} {'estimate':>12s} "
        f"{'95 %':>25s}",
    ]
    for name, p in result["parameters"].items():
        lines.append(
            f"{name:30s} {p['prior']:12.4g} {truth['parameters'][name]:12.4g} {p['value']:12.4g} "
            f"{p['low']:12.4g} .. {p['high']:9.4g}"
        )
    shown = {"mae_data_sheet": "data sheet", "mae_refitted": "refitted"}
    shown |= {"mae_with_cause": "with cause"} if result["causes"] else {}
    shown |= {"noise_floor": "noise floor"}
    lines += ["", f"{'held-out MAE':30s} " + " ".join(f"{h:>12s}" for h in shown.values())]
    for channel, h in result["how_far"].items():
        lines.append(f"{channel:30s} " + " ".join(f"{h[key]:12.4g}" for key in shown))
    for channel, errors in (result["network"] or {}).items():
        lines.append(
            f"Network in place of the cause, in closed loop: {channel} {errors['refitted']:.4g} "
            f"-> {errors['with_network']:.4g}"
        )
    lines += [
        "",
        f"Page: {result['page']}",
        f"Next: pamid effects {truth['effect']}   or   pamid diagnose {quoted(output / 'rec.csv')} "
        f"--output {unused('run')}",
    ]
    return "\n".join(lines)
