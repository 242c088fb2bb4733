"""`pamid demo`: Everything above on a virtual rig, in about a minute."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from . import frame
from .hints import unused
from .job import parameter_values
from .options import jobs_option, run_output_option, seed_option
from .terminal import aside, progress_line, quoted

PLACE = 190
EXAMPLE = """
pamid demo --output demo-run --seed 1
"""
_BEGUN = (
    "A virtual joint is recorded with a fault that is withheld; then it is fitted, diagnosed, a "
    "network is trained and the page is written: about a minute."
)
_BEGUN_OTHER = (
    "A virtual machine is recorded with a fault that is withheld; then it is fitted and diagnosed, "
    "and the page is written."
)


@frame.command("demo", example=EXAMPLE)
@run_output_option("demo-run")
@click.option(
    "--rig",
    default="one-dof",
    show_default=True,
    help="Rig by name, or the path of a rig file (it is run): a virtual machine is made of it.",
)
@seed_option("Draws what is withheld, the excitation and the noise.", 1)
@jobs_option("Threads to use.")
@click.option(
    "--duration",
    type=click.FloatRange(15.0, 3600.0),
    default=60.0,
    show_default=True,
    help="Length of the recording of the one-dof in s; on another rig its usual holds decide.",
)
@frame.overwrite_option("Replace an earlier run in that folder.")
def command(
    output: Path, rig: str, seed: int, jobs: int, duration: float, overwrite: bool
) -> frame.Result:
    """Build a virtual joint with an effect that is withheld and parameters that are off, record it,
    diagnose it, train a network on what is left over, write the report page, and compare what was
    named with what was withheld.

    With --rig the same for a machine that is made of that rig as `pamid trial` makes them, without
    the network. What is withheld is drawn from all that fits its ports, and need not show.
    """
    # before what takes seconds to load
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
        "right": "Right: the withheld effect's family is the one named.",
        "among": "Among those named is the withheld effect's family.",
        "missed": "Missed: the withheld effect's family was not named.",
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
