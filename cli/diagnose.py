"""`pamid diagnose`: Find where the gap lies, which effect causes it, how far it shrinks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from . import frame
from .job import cluster_option, failed_text, said_of
from .options import jobs_option, no_check_option, recording_options, run_output_option, seed_option
from .terminal import progress_line, quoted, warning

PLACE = 80
EXAMPLE = """
pamid diagnose rec.csv --rig one-dof --output run --jobs 2
"""


@frame.command("diagnose", example=EXAMPLE)
@recording_options
@click.option(
    "--effect",
    "effects",
    multiple=True,
    type=click.Path(path_type=Path),
    help="File with a further effect to consider (it is run).",
)
@click.option("--without", multiple=True, help="Effect of the catalogue to leave out.")
@seed_option("Same inputs and seed, same output.")
@jobs_option()
@run_output_option
@no_check_option
@cluster_option
@click.option(
    "--resume", is_flag=True, help="Go on with the same diagnosis where it was interrupted."
)
@frame.overwrite_option("Replace an earlier run in that folder.")
def command(
    recordings: tuple[Path, ...],
    rig: str | None,
    held_out: tuple[Path, ...],
    effects: tuple[Path, ...],
    without: tuple[str, ...],
    seed: int,
    jobs: int,
    output: Path,
    no_check: bool,
    cluster: str | None,
    resume: bool,
    overwrite: bool,
) -> frame.Result:
    """Say where a model departs from its recordings, which effect of the catalogue causes it, and
    how far the gap shrinks once that effect is added, on recordings that neither the parameters nor
    the choice have seen.

    Interrupted or killed, it keeps every finished job in the run folder (jobs/, removed when all is
    done); the same command with --resume repeats none of them. Where single jobs fail the rest is
    written, and the exit code is 6.
    """
    from pamid.api.diagnosing import diagnose

    with progress_line("diagnose") as progress:
        run = diagnose(
            list(recordings),
            rig,
            held_out=list(held_out),
            effects=[str(file) for file in effects],
            without=without,
            seed=seed,
            jobs=jobs,
            cluster=cluster,
            output=output,
            overwrite=overwrite,
            resume=resume,
            check=not no_check,
            progress=progress,
            warn=warning,
            command=frame.command_line(),
        )
    found, text = said_of(output / "diagnosis.json", lambda found: diagnosis_text(found, output))
    return frame.Result(found, text, 6 if run.failed_jobs else 0)


def diagnosis_text(found: dict[str, Any], output: Path) -> str:
    """The three answers, the ranking, and what to do next; where the recordings show nothing of the
    model, that alone.
    """
    if found.get("remark"):
        return "\n".join(
            [
                found["remark"],
                "",
                *_how_far(found),
                *failed_text(found),
                f"Next: pamid report {quoted(output)}",
            ]
        )
    lines = [found["sentence"], "", *_where(found["where"]), *_which(found["causes"])]
    lines += _free_forms(found.get("unknown") or {})
    lines += _how_far(found)
    lines.append("          (on the half of the held-out windows that did not choose the effect)")
    lines += ["", f"{'effect':36s} {'family':20s} {'P':>5s} {'shrinkage':>10s} {'95 %':>16s}"]
    lines += [
        f"{r['effect']:36s} {r['family']:20s} {r['probability']:5.2f} {100 * r['shrinkage']:8.1f} "
        f"% {100 * r['low']:6.1f} .. {100 * r['high']:5.1f}"
        for r in found["ranking"][:8]
    ]
    lines += _further(found, output)
    lines += [f"Note      {note}" for note in found.get("notes") or []]
    lines += failed_text(found)
    lines.append(f"Next: pamid report {quoted(output)}")
    return "\n".join(lines)


def _where(where: dict[str, Any]) -> list[str]:
    """Ports, the regimes in which the gap shows, and a sensor that would tell more."""
    shares = [
        f"{p['port']} {100 * p['share']:.0f} %" for p in where["ports"][:4] if p["share"] >= 0.005
    ]
    lines = ["Where     " + ", ".join(shares)]
    lines += [
        f"          {100 * r['share_of_gap']:.0f} % of the gap in {100 * r['share_of_time']:.0f} % "
        f"of the time: {r['signal']} {r['low']:.3g} .. {r['high']:.3g} {r['unit']}"
        for r in where["regimes"][:2]
    ]
    if where.get("sensors"):
        split = " or ".join(", ".join(g) for g in where["sensors"][0]["splits"][:2])
        lines.append(
            f"          a measurement of {where['sensors'][0]['sensor']} would split {split}"
        )
    return lines


def _which(causes: list[dict[str, Any]]) -> list[str]:
    lines = []
    for i, c in enumerate(causes):
        values = ", ".join(
            f"{k} {v['value']:.4g} ({v['low']:.4g} .. {v['high']:.4g})"
            for k, v in c["parameters"].items()
        )
        lines.append(
            ("Which     " if i == 0 else "          ") + f"{c['effect']} ({c['family']}): {values}"
        )
    return lines


def _free_forms(unknown: dict[str, Any]) -> list[str]:
    """Families whose free forms take up what has no name, each with a few points of its curve."""
    lines = []
    for i, form in enumerate(unknown.get("free_forms") or []):
        curve = form["curve"]
        points = list(zip(curve["x"], curve["y"], strict=True))
        shown = ", ".join(f"{y:.3g} at {x:.3g}" for x, y in points[:: max(1, len(points) // 6)])
        lines += [
            ("Family    " if i == 0 else "       or ")
            + f"{form['family']} at the {form['port']}, {form['known_by']}: removes "
            f"{100 * form['shrinkage']:.0f} % ({100 * form['low']:.0f} .. "
            f"{100 * form['high']:.0f})",
            f"          {curve['shown']} [{curve['unit'] or '-'}] over {curve['signal']} "
            f"[{curve['signal_unit'] or '-'}]: {shown}",
        ]
    return lines


def _further(found: dict[str, Any], output: Path) -> list[str]:
    """How sure it is, and what to measure next."""
    lines = []
    sure = found.get("confidence")
    if sure:
        lines += [
            "",
            f"Calibrated: a gap {100 * sure['gap']:.0f} %, its cause in the catalogue "
            f"{100 * sure['known']:.0f} %, the first one (or a look-alike) "
            f"{100 * sure['first']:.0f} %.",
        ]
    n = found["next_experiment"]
    if n:
        lines.append(
            f"Measure next: {n['name']}, {n['minutes']:.2g} min on the rig, separates "
            f"{' and '.join(n['separates'])}; ready to run: "
            + " and ".join(
                quoted(output / name) for name in n.get("excitations") or [n["excitation"]]
            )
        )
    return lines


def _how_far(found: dict[str, Any]) -> list[str]:
    return [
        ("How far   " if i == 0 else "          ")
        + f"{c}: {h['mae_data_sheet']:.4g} data sheet, {h['mae_refitted']:.4g} refitted, "
        f"{h['mae_with_cause']:.4g} with the cause (noise floor {h['noise_floor']:.4g})"
        for i, (c, h) in enumerate(found["how_far"].items())
    ]
