"""`pamid force-law`: Train a muscle's force law on a measured map and compare analytic laws."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from . import frame, names
from .options import run_output_option, seed_option
from .terminal import aside, progress_line, quoted

HELP_ORDER = 70
EXAMPLE = """
pamid force-law data/example/muscle_map.csv --output law
pamid check law/rig.py
"""


@frame.command("force-law", example=EXAMPLE)
@click.argument("map_file", metavar="MAP", type=click.Path(path_type=Path))
@run_output_option("force-law-run")
@click.option(
    "--sets",
    type=click.IntRange(2, 10),
    default=3,
    show_default=True,
    help="Membership sets on contraction and on pressure.",
)
@click.option(
    "--rig",
    type=click.Choice(names.rigs_with("static_force")),
    default="one-dof",
    show_default=True,
    help="Rig whose muscles get the law.",
)
@seed_option("Same map and seed, same law.")
@click.option(
    "--held-out",
    "every",
    type=click.IntRange(2, 20),
    default=3,
    show_default=True,
    metavar="K",
    help="Cross-validation in K folds: each holds out one point in K.",
)
@click.option(
    "--strict/--no-strict",
    default=True,
    show_default=True,
    help="Refuse a map in which the force falls with pressure or grows with contraction. (If only "
    "the law does so, it is constrained.)",
)
@frame.overwrite_option("Replace an earlier run in that folder.")
def command(
    map_file: Path,
    output: Path,
    sets: int,
    rig: str,
    seed: int,
    every: int,
    strict: bool,
    overwrite: bool,
) -> frame.Result:
    """Train an ANFIS on MAP, the measured force map of a muscle, compare it with the analytic force
    laws on held-out points, and make it the force law of a rig.

    MAP is a CSV file with the columns contraction (share of the length at rest), pressure_kpa
    (gauge) and force_n, one row per point. Other units of these are accepted, as pressure_bar. The
    analytic laws are scored as published, and with their factor `scale` fitted to the other points.
    A slack muscle reads zero force, so the network learns the amount of slack from the nearest
    analytic law.

    Writes network.json, network.npz, force-law.json, figures/force-map.png and rig.py, which works
    as any rig: --rig OUTPUT/rig.py. A rig file is code and is run when you name it. Nothing else in
    the folder is run.
    """
    from pamid.base.errors import DataError
    from pamid.base.run_folder import Run
    from pamid.correction.force_law_run import write_law
    from pamid.correction.force_map import judge, read_map

    points = read_map(map_file)
    for name in points.unused:
        aside(f"Warning: {map_file}: the column {name!r} is not used.")
    run = Run.create(
        output,
        command=frame.command_line(),
        seed=seed,
        inputs=[map_file],
        overwrite=overwrite,
        options={"sets": sets, "rig": rig, "held_out": every, "strict": strict},
    )
    try:
        with progress_line("force-law") as progress:
            validated = judge(
                points,
                sets=sets,
                every=every,
                seed=seed,
                progress=progress.say,
            )
        if strict and not validated.monotone:
            remedies = [
                *["use fewer --sets"] * (sets > 2),
                "measure more points there",
                "or accept the law with --no-strict (and --overwrite: the folder exists now)",
            ]
            raise DataError(
                validated.guard, f"{', '.join(remedies).capitalize()}.", code="not-monotone"
            )
        about = write_law(run, validated, rig, strict)
    except DataError:
        run.finish("failed")
        raise
    run.finish()
    return frame.Result(about, law_text(about, output))


def law_text(about: dict[str, Any], output: Path) -> str:
    """Table of all laws on held-out points, the result of the monotonicity check, and advice."""
    anfis, points, rig = about["anfis"], about["map"], output / about["rig"]["file"]
    spans = ", ".join(
        f"{name} {points[name]['low']:.4g} to {points[name]['high']:.4g}"
        for name in ("contraction", "pressure_kpa", "force_n")
    )
    each = ", ".join(f"{value:.3g}" for value in anfis["rms_n_each_way"])
    rows = [
        (
            f"ANFIS {anfis['sets']}x{anfis['sets']}",
            anfis["rms_n"],
            anfis["worst_n"],
            None,
            None,
            anfis["contraction_held_out_rms_n"],
        ),
        *(
            (
                law["law"],
                law["rms_n"],
                law["worst_n"],
                law["scaled_rms_n"],
                law["scale"],
                law["contraction_held_out_scaled_rms_n"],
            )
            for law in about["laws"]
        ),
    ]
    widths = (9, 9, 14, 8, 24)
    lines = [
        f"{points['points']} points, {points['slack_points']} of them slack: {spans}",
        f"{about['held_out_every']}-fold cross-validation; ANFIS by fold: {each} N RMS",
        "",
        f"{'law':18s}"
        + "".join(
            f"{word:>{wide}s}"
            for word, wide in zip(
                ("RMS N", "worst N", "RMS scaled N", "scale", "contraction held out N"),
                widths,
                strict=True,
            )
        ),
    ]
    for name, *values in rows:
        cells = [
            "-" if v is None else f"{v:.3f}" if k == 3 else f"{v:.1f}" for k, v in enumerate(values)
        ]
        lines.append(
            f"{name:18s}"
            + "".join(f"{cell:>{wide}s}" for cell, wide in zip(cells, widths, strict=True))
        )
    return "\n".join(
        [
            *lines,
            "",
            f"{about['finding']}.",
            *about["advice"],
            about["monotone"]["words"],
            f"Next: pamid check {quoted(rig)}   or   --rig {quoted(rig)} in simulate, fit or "
            "diagnose, which run that file.",
        ]
    )
