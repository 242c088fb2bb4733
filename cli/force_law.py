"""`pamid force-law`: Train a muscle's force law on a measured map, beside the analytic ones."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from . import frame, names
from .options import run_output_option, seed_option
from .terminal import aside, progress_line, quoted

PLACE = 70
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
    help="One point in K is held out, in all K ways.",
)
@click.option(
    "--strict/--no-strict",
    default=True,
    show_default=True,
    help="Refuse a map by which the force falls with pressure or grows with contraction. (A law "
    "that does so where its map does not is constrained.)",
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
    laws on points that none of them has seen, and make it the force law of a rig.

    MAP is a CSV file with the columns contraction (share of the length at rest), pressure_kpa
    (gauge) and force_n, one row per point; other units of these will do, as pressure_bar. The
    analytic laws are judged as printed and with their factor `scale` fitted to the points that are
    not held out. Where the muscle is slack, the network learns how slack it is from the nearest
    analytic law: the reading of zero does not say.

    Writes network.json, network.npz, force-law.json, figures/force-map.png and rig.py, which serves
    wherever a rig is named: --rig OUTPUT/rig.py. A rig file is code and is run when you name it;
    nothing else in the folder is.
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
                *["take fewer --sets"] * (sets > 2),
                "measure more there",
                "or accept it with --no-strict (and --overwrite: this run has taken the folder)",
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
    """The table of all laws on what was held out, what the guard finds, and what to do next."""
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
        f"one point in {about['held_out_every']} held out, in all ways; ANFIS each way: {each} N "
        "RMS",
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
