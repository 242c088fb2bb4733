"""`pamid animate`: Show how a run's rig moved, measured over simulated, as a GIF."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pamid.api.options.record import (
    AnyPath,
    FilePath,
    RigName,
    argument,
    option,
)
from pamid.base.files import make_folder, require_new, write_atomically

from . import frame
from .terminal import progress_line

HELP_ORDER = 130
EXAMPLE = """
pamid animate fitted --output arm.gif
"""


@dataclass(frozen=True)
class Arguments:
    """Draw the measured and the simulated motion of the run folder RUN as an animated GIF.

    The measured motion is dark and thick, the best model lies over it, and the model before it is
    dashed. A plot below shows the errors. The rig needs a pose.
    """

    run: AnyPath = argument()
    output: FilePath | None = option(None, "GIF to write. [default: RUN/figures/motion.gif]")
    rig: RigName | None = option(
        None, "Path of the rig's file (it is run), where the rig is not in the catalogue."
    )
    begin: float | None = option(
        None,
        "Time of the recording to begin with. [default: at most 12 s of the held-out part, where "
        "the refitted model errs most]",
        "--from",
        metavar="S",
    )
    end: float | None = option(None, "Time of the recording to end with.", "--to", metavar="S")
    speed: float = option(
        1.0, "Seconds of the recording per second of the animation.", least=0.01, most=100.0
    )
    size: int = option(480, "Width in pixels.", least=160, most=1600)
    overwrite: bool = option(False, "Replace the output if it exists.", formerly="--force")


@frame.command("animate", Arguments, example=EXAMPLE)
def command(arguments: Arguments) -> frame.Result:
    from pamid.base.run_folder import FIGURES_FOLDER, Run
    from pamid.base.schemas.command_files import WrittenAnimation
    from pamid.report.animation import ANIMATION_HZ, gif_of, size_px
    from pamid.report.load import load_run
    from pamid.report.motion import motion_of, rig_of_run

    a, folder = arguments, Path(arguments.run)
    target = Path(a.output) if a.output else None
    require_new([target] if target else [], a.overwrite)
    data = load_run(folder)
    motion = motion_of(data, rig_of_run(data, a.rig), a.speed / ANIMATION_HZ, a.begin, a.end)
    with progress_line("animate", motion.time.size) as progress:
        gif = gif_of(motion, a.size, lambda done, of: progress.update(done, "frames"))
    if target is None:
        target = Run.open(folder).path(f"{FIGURES_FOLDER}/motion.gif")
    make_folder(target.parent)
    write_atomically(target, gif)
    width, height = size_px(gif)
    result = WrittenAnimation(
        output=str(target),
        rig=data.rig,
        recording=motion.recording,
        from_s=motion.time[0],
        to_s=motion.time[-1],
        speed=a.speed,
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
