"""`pamid animate`: Show how a run's rig moved, measured over simulated, as a GIF."""

from __future__ import annotations

from pathlib import Path

import click

from . import frame
from .terminal import progress_line

HELP_ORDER = 130
EXAMPLE = """
pamid animate fitted --output arm.gif
"""


@frame.command("animate", example=EXAMPLE)
@click.argument("run", type=click.Path(path_type=Path))
@click.option(
    "--output",
    type=click.Path(dir_okay=False, path_type=Path),
    help="GIF to write. [default: RUN/figures/motion.gif]",
)
@click.option(
    "--rig", help="Path of the rig's file (it is run), where the rig is not in the catalogue."
)
@click.option(
    "--from",
    "begin",
    type=float,
    metavar="S",
    help="Time of the recording to begin with. [default: at most "
    "12 s of the held-out part, where the refitted model errs most]",
)
@click.option("--to", "end", type=float, metavar="S", help="Time of the recording to end with.")
@click.option(
    "--speed",
    type=click.FloatRange(0.01, 100.0),
    default=1.0,
    show_default=True,
    help="Seconds of the recording per second of the animation.",
)
@click.option(
    "--size",
    type=click.IntRange(160, 1600),
    default=480,
    show_default=True,
    help="Width in pixels.",
)
@frame.overwrite_option("Replace the output if it exists.", formerly_force=True)
def command(
    run: Path,
    output: Path | None,
    rig: str | None,
    begin: float | None,
    end: float | None,
    speed: float,
    size: int,
    overwrite: bool,
) -> frame.Result:
    """Draw the measured and the simulated motion of the run folder RUN as an animated GIF.

    The measured motion is dark and thick, the best model lies over it, and the model before it is
    dashed. A plot below shows the errors. The rig needs a pose.
    """
    from pamid.base.files import make_folder, require_new, write_atomically
    from pamid.base.run_folder import FIGURES_FOLDER, Run
    from pamid.report.animation import ANIMATION_HZ, gif_of, size_px
    from pamid.report.load import load_run
    from pamid.report.motion import motion_of, rig_of_run
    from pamid.schemas.command_files import WrittenAnimation

    require_new([output] if output else [], overwrite)
    data = load_run(run)
    motion = motion_of(data, rig_of_run(data, rig), speed / ANIMATION_HZ, begin, end)
    with progress_line("animate", motion.time.size) as progress:
        gif = gif_of(motion, size, lambda done, of: progress.update(done, "frames"))
    if output is None:
        target = Run.open(run).path(f"{FIGURES_FOLDER}/motion.gif")
    else:
        target = output
        make_folder(target.parent)
    write_atomically(target, gif)
    width, height = size_px(gif)
    result = WrittenAnimation(
        output=str(target),
        rig=data.rig,
        recording=motion.recording,
        from_s=motion.time[0],
        to_s=motion.time[-1],
        speed=speed,
        frames=motion.time.size,
        frames_per_second=ANIMATION_HZ,
        width_px=width,
        height_px=height,
        bytes=len(gif),
        mean_gap=motion.means,
    )
    return frame.Result(
        result,
        f"{motion.title}.\n{target}: {motion.time[0]:.2f} to {motion.time[-1]:.2f} s, "
        f"{motion.time.size} frames, {width} x {height} px, {len(gif) / 1000:.0f} kB.",
    )
