"""`pamid demo`: Run the whole workflow on a virtual rig, in about a minute."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from . import frame
from .hints import unused
from .job import parameter_values
from .options import jobs_option, run_output_option, seed_option
from .terminal import aside, progress_line, quoted

HELP_ORDER = 190
EXAMPLE = """
pamid demo --output demo-run --seed 1
"""
_BEGUN = (
    "Recording a virtual joint with a hidden fault, then fit, diagnosis, training of a network and "
    "report: about a minute."
)
_BEGUN_OTHER = "Recording a virtual machine with a hidden fault, then fit, diagnosis and report."


@frame.command("demo", example=EXAMPLE)
@run_output_option("demo-run")
@click.option(
    "--rig",
    default="one-dof",
    show_default=True,
    help="Rig of the virtual machine, by name or by the path of a rig file (it is run).",
)
@seed_option("Seed of the hidden fault, the excitation and the noise.", 1)
@jobs_option("Threads to use.")
@click.option(
    "--duration",
    type=click.FloatRange(15.0, 3600.0),
    default=60.0,
    show_default=True,
    help="Length of the recording of the one-dof in s. The hold times of another rig "
    "determine its length.",
)
@frame.overwrite_option("Replace an earlier run in that folder.")
def command(
    output: Path, rig: str, seed: int, jobs: int, duration: float, overwrite: bool
) -> frame.Result:
    """Build a virtual joint with a hidden effect and wrong parameters, record and diagnose it,
    train a network on the residual, write the report, and compare the diagnosis with the truth.

    With --rig the machine is built from that rig, as in `pamid trial`, and no network is trained.
    The hidden effect is drawn from all effects that fit its ports, and may be too small to show.
    """
    # before the imports, which take seconds
    aside(_BEGUN if rig == "one-dof" else _BEGUN_OTHER)
    from pamid.base.run_folder import Run
    from pamid.model.registry import code_files
    from pamid.replications.demonstration import run_demo

    run = Run.create(
        output,
        command=frame.command_line(),
        seed=seed,
        inputs=code_files(rig, ()),
        overwrite=overwrite,
        options={"jobs": jobs, **({"duration_s": duration} if rig == "one-dof" else {"rig": rig})},
    )
    with progress_line("demo") as progress:
        result = run_demo(
            run,
            seed=seed,
            jobs=jobs,
            duration_s=duration,
            rig=rig,
            progress=progress.say,
        )
    return frame.Result(result, demo_text(result, output))


def demo_text(result: dict[str, Any], output: Path) -> str:
    """Withheld effect and diagnosed cause, as text."""
    truth = result["withheld"]
    judged = {
        "right": "Right: the family of the withheld effect is the one named.",
        "among": "Partly right: the family of the withheld effect is among those named.",
        "missed": "Missed: the family of the withheld effect was not named.",
    }[result["hit"]]
    lines = [
        f"Withheld  {truth['effect']} ({truth['family']}): {', '.join(truth['as_simulated'])}",
        f"Named     {result['sentence']}",
    ]
    for cause in result["causes"]:
        values = parameter_values(cause["parameters"])
        lines.append(f"          {cause['effect']} ({cause['family']}): {values}")
    lines += [
        judged,
        "",
        f"{'parameter':30s} {'data sheet':>12s} {'withheld':>12s} {'found':>12s} {'95 %':>25s}",
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
            f"A network instead, on the model in its own loop: {channel} {errors['refitted']:.4g} "
            f"-> {errors['with_network']:.4g}"
        )
    lines += [
        "",
        f"Page: {result['page']}",
        f"Next: pamid effects {truth['effect']}   or   pamid diagnose {quoted(output / 'rec.csv')} "
        f"--output {unused('run')}",
    ]
    return "\n".join(lines)
