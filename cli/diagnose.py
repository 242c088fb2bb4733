"""`pamid diagnose`: where the gap lies, which effect causes it, how far it shrinks."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from . import frame
from .job import carried_through, cluster_option, failed_text, kept, pool_of, require_one_of
from .options import evidence_from, no_check_option, with_sidecar
from .progress_bar import ProgressBar
from .terminal import quoted

if TYPE_CHECKING:
    from pamid.model.effect import Effect

EXAMPLE = """
pamid diagnose rec.csv --rig one-dof --output run --jobs 2
"""


@frame.command("diagnose", example=EXAMPLE)
@click.argument("recordings", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--rig",
    help="Rig by name, or the path of a rig file (it is run). "
    "[default: the one the recordings name, else one-dof]",
)
@click.option(
    "--held-out",
    multiple=True,
    type=click.Path(path_type=Path),
    help="Recording nobody fits. [default: the last 30 % of every recording]",
)
@click.option(
    "--effect",
    "effects",
    multiple=True,
    type=click.Path(path_type=Path),
    help="File with a further effect to consider (it is run).",
)
@click.option("--without", multiple=True, help="Effect of the catalogue to leave out.")
@click.option(
    "--seed",
    type=click.IntRange(0),
    default=0,
    show_default=True,
    help="Same inputs and seed, same output.",
)
@click.option(
    "--jobs", type=click.IntRange(1, 256), default=2, show_default=True, help="Processes to use."
)
@click.option(
    "--output",
    type=click.Path(file_okay=False, path_type=Path),
    required=True,
    help="Run folder to make.",
)
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
    from pamid.base.run_folder import JOBS, Run
    from pamid.diagnosis.diagnose import diagnose_into
    from pamid.model.registry import code_files, rig_of

    require_one_of(resume, overwrite)
    evidence = evidence_from(rig, recordings, held_out, check=not no_check)
    catalogue = _catalogue(effects, without)
    inputs = [f for p in (*recordings, *held_out) for f in with_sidecar(p)]
    inputs += code_files(rig, [str(e) for e in effects])
    with pool_of(jobs, cluster, kept=output / JOBS) as pool:
        run = Run.create(
            output,
            command=frame.command_line(),
            seed=seed,
            inputs=inputs,
            overwrite=overwrite,
            resume=resume,
            options={
                "rig": rig or rig_of(evidence.recordings),
                "effects": [str(e) for e in effects],
                "without": list(without),
            },
        )
        if run.record["outcome"] == "done":  # resumed, and nothing is left to do
            return frame.Result(
                *kept(run.path("diagnosis.json"), lambda found: diagnosis_text(found, output))
            )
        with carried_through(run, pool), ProgressBar("diagnose") as progress:
            found = diagnose_into(
                run,
                evidence,
                catalogue,
                seed=seed,
                progress=lambda text: progress.update(0, text),
                pool=pool,
            )
    return frame.Result(found, diagnosis_text(found, output), 6 if pool.failed else 0)


def _catalogue(files: tuple[Path, ...], without: tuple[str, ...]) -> dict[str, type[Effect]]:
    from pamid.base.errors import UsageError, nearest
    from pamid.model.registry import effects_with

    known, _ = effects_with(tuple(str(f) for f in files))
    for name in without:
        if name not in known:
            raise UsageError(f"--without {name!r}: no such effect.", nearest(name, list(known)))
        del known[name]
    return known


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
    where = found["where"]
    lines = [
        found["sentence"],
        "",
        "Where     "
        + ", ".join(
            f"{p['port']} {100 * p['share']:.0f} %"
            for p in where["ports"][:4]
            if p["share"] >= 0.005
        ),
    ]
    lines += [
        f"          {100 * r['share_of_gap']:.0f} % of the gap in {100 * r['share_of_time']:.0f} "
        "% of the time: "
        f"{r['signal']} {r['low']:.3g} .. {r['high']:.3g} {r['unit']}"
        for r in where["regimes"][:2]
    ]
    if where.get("sensors"):
        split = " or ".join(", ".join(g) for g in where["sensors"][0]["splits"][:2])
        lines.append(
            f"          a measurement of {where['sensors'][0]['sensor']} would split {split}"
        )
    for i, c in enumerate(found["causes"]):
        values = ", ".join(
            f"{k} {v['value']:.4g} ({v['low']:.4g} .. {v['high']:.4g})"
            for k, v in c["parameters"].items()
        )
        lines.append(
            ("Which     " if i == 0 else "          ") + f"{c['effect']} ({c['family']}): {values}"
        )
    lines += _how_far(found)
    lines.append("          (on the half of the held-out windows that did not choose the effect)")
    lines += ["", f"{'effect':36s} {'family':20s} {'P':>5s} {'shrinkage':>10s} {'95 %':>16s}"]
    lines += [
        f"{r['effect']:36s} {r['family']:20s} {r['probability']:5.2f} {100 * r['shrinkage']:8.1f} "
        "% "
        f"{100 * r['low']:6.1f} .. {100 * r['high']:5.1f}"
        for r in found["ranking"][:8]
    ]
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
    lines += failed_text(found)
    lines.append(f"Next: pamid report {quoted(output)}")
    return "\n".join(lines)


def _how_far(found: dict[str, Any]) -> list[str]:
    return [
        ("How far   " if i == 0 else "          ")
        + f"{c}: {h['mae_data_sheet']:.4g} data sheet, {h['mae_refitted']:.4g} refitted, "
        f"{h['mae_with_cause']:.4g} with the cause (noise floor {h['noise_floor']:.4g})"
        for i, (c, h) in enumerate(found["how_far"].items())
    ]
