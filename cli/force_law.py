"""`pamid force-law`: Train a muscle's force law on a measured map and compare analytic laws."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pamid.api.options.names import rigs_with
from pamid.api.options.record import (
    AnyPath,
    FolderPath,
    argument,
    option,
    overwrite_option,
    seed_option,
)
from pamid.base.errors import DataError, quoted

from . import frame
from .terminal import progress_line, warning

HELP_ORDER = 70
EXAMPLE = """
pamid force-law data/example/muscle_map.csv --output law
pamid check law/rig.py
"""


@dataclass(frozen=True)
class Arguments:
    """Train an ANFIS on MAP, the measured force map of a muscle, compare it with the analytic force
    laws on held-out points, and make it the force law of a rig.

    MAP is a CSV file with the columns contraction (share of the length at rest), pressure_kpa
    (gauge) and force_n, a row per point. Other units of these are accepted, as pressure_bar. The
    analytic laws are scored as published, and with their factor `scale` fitted to the other points.
    A slack muscle reads zero force, so the network learns the amount of slack from the nearest
    analytic law.

    Writes network.json, network.npz, force-law.json, figures/force-map.png and rig.py, which works
    as any rig: --rig OUTPUT/rig.py. A rig file is code and is run when you name it. Nothing else in
    the folder is run.
    """

    map_file: AnyPath = argument(metavar="MAP")
    output: FolderPath = option("force-law-run", "Run folder to create.")
    sets: int = option(3, "Membership sets on contraction and on pressure.", least=2, most=10)
    rig: str = option(
        "one-dof", "Rig whose muscles get the law.", choices=tuple(rigs_with("static_force"))
    )
    seed: int = seed_option("The same map and seed give the same law.")
    every: int = option(
        3,
        "Cross-validation in K folds: each holds out every K-th point.",
        "--held-out",
        metavar="K",
        least=2,
        most=20,
    )
    strict: bool = option(
        True,
        "Refuse a map in which the force falls with pressure or grows with contraction. (If only "
        "the law does so, it is constrained.)",
    )
    overwrite: bool = overwrite_option("Replace an earlier run in that folder.")


@frame.command("force-law", Arguments, example=EXAMPLE)
def command(arguments: Arguments) -> frame.Result:
    from pamid.api.force_law_run import write_law
    from pamid.base.run_folder import Run
    from pamid.networks.correction.force_map import judge, read_map

    a, map_file, output = arguments, Path(arguments.map_file), Path(arguments.output)
    points = read_map(map_file)
    for name in points.unused:
        warning(f"{map_file}: the column {name!r} is not used.")
    run = Run.create(
        output,
        command=frame.command_line(),
        seed=a.seed,
        inputs=[map_file],
        overwrite=a.overwrite,
        options={"sets": a.sets, "rig": a.rig, "held_out": a.every, "strict": a.strict},
    )
    try:
        with progress_line("force-law") as progress:
            validated = judge(
                points,
                sets=a.sets,
                every=a.every,
                seed=a.seed,
                progress=progress.say,
            )
        if a.strict and not validated.monotone:
            remedies = [
                *["use fewer --sets"] * (a.sets > 2),
                "measure more points there",
                "or accept the law with --no-strict (and --overwrite: the folder exists now)",
            ]
            raise DataError(
                validated.guard, f"{', '.join(remedies).capitalize()}.", code="not-monotone"
            )
        about = write_law(run, validated, a.rig, a.strict)
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
