"""A virtual machine with something withheld, diagnosed blind: what `pamid demo` does.

On the joint the seed draws an effect from a short list, mistunes the parameters of the rig by 10
to 20 % and adds sensor noise. Of any other rig a machine is made as the blind trial makes it: any
effect that fits, in another form than the catalogue's. What was drawn goes into `withheld.json`,
which nothing but the final comparison reads.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pamid.api.diagnosing import diagnose
from pamid.api.simulating import simulate
from pamid.api.training import train_residual
from pamid.base.json_file import read_json, write_json
from pamid.base.progress import Progress, silent
from pamid.base.run_folder import Run
from pamid.base.schemas.demo_file import DemoOutput, Hit, WithheldFile
from pamid.model.registry import catalogue_rig, effects
from pamid.recording.recording import TIME, write_recording
from pamid.report.writing import write_report
from pamid.simulation.excitation.aprbs import aprbs
from pamid.simulation.virtual_rig import split_spec
from pamid.trial.faults import NAMELESS
from pamid.trial.own_machine import OwnMachine, draw_specimen, machine_of

DEMO_RIG = "one-dof"
PERIOD_S, AMPLITUDE_DEG, HOLD_S = 0.003, 40.0, (0.4, 1.6)
#: effects that a minute of motion brings to light clearly, with their size
WITHHELD_EFFECTS = (
    "coulomb-friction:torque_n_m=0.4",
    "dead-time:delay_s=0.024",
    "valve-dead-band:dead_band=0.08",
    "leak:share=0.03",
    "end-stop:limit_rad=0.5",
    "angle-sensor-lag:time_constant_s=0.02",
)
#: parameters of the rig that are off, each by 10 to 20 % up or down
MISTUNED = (
    "damping_m2_s",
    "scale",
    "conductance_in_m3_per_s_pa",
    "conductance_out_m3_per_s_pa",
    "viscous_n_m_s",
)
OFF_BY = (0.10, 0.20)
ITERATIONS = 40  # of the network: enough to show what it is worth, not its best
TRUTH_FILE = "withheld.json"
EXCITATION_FILE, RECORDING_FILES = "excitation.csv", ("rec.csv", "rec.toml")


@dataclass(frozen=True)
class Withheld:
    """spec: the effect as `--effect` takes it; factors: true value of a parameter of the rig over
    its data-sheet value."""

    effect: str
    family: str
    spec: str
    factors: dict[str, float]


def draw_withheld(seed: int) -> Withheld:
    """The effect and the mistuned parameters of a seed."""
    random = np.random.default_rng(seed)
    spec = WITHHELD_EFFECTS[int(random.integers(len(WITHHELD_EFFECTS)))]
    off = random.uniform(*OFF_BY, len(MISTUNED)) * random.choice([-1.0, 1.0], len(MISTUNED))
    name = split_spec(spec)[0]
    factors = {key: round(1.0 + float(x), 4) for key, x in zip(MISTUNED, off, strict=True)}
    return Withheld(name, effects()[name].family, spec, factors)


def write_demo_recording(folder: Path, withheld: Withheld, *, seed: int, duration_s: float) -> Path:
    """excitation.csv, rec.csv (with TOML), withheld.json in `folder`; returns rec.csv's path."""
    reference = aprbs(duration_s, PERIOD_S, AMPLITUDE_DEG, HOLD_S, seed=seed)
    time = PERIOD_S * np.arange(reference.size)
    excitation, recording = folder / EXCITATION_FILE, folder / RECORDING_FILES[0]
    write_recording(excitation, time, {"reference_deg": reference})
    sheet = {p.outside_name: p.value for p in catalogue_rig(DEMO_RIG).parameters}
    hidden = {key: sheet[key] * factor for key, factor in withheld.factors.items()}
    simulated = simulate(
        excitation, DEMO_RIG, effects=withheld.spec, parameters=hidden, seed=seed, output=recording
    )
    truth = WithheldFile(
        seed=seed,
        effect=withheld.effect,
        family=withheld.family,
        as_simulated=tuple(simulated.effects),
        parameters=hidden,
        over_data_sheet=withheld.factors,
    )
    write_json(folder / TRUTH_FILE, truth.as_json())
    return recording


def write_rig_recording(folder: Path, machine: OwnMachine, *, seed: int) -> Path:
    """The same for a machine that is made of a rig."""
    random = np.random.default_rng(seed)
    known = [name for name in machine.faults if not name.startswith(NAMELESS)]
    name = known[int(random.integers(len(known)))]
    c = machine.draw_conditions(random, [machine.faults[name]], clean=False)
    site, sizes = machine.plant(name, random)
    specimen = draw_specimen(machine, random, c)
    sent = machine.excitation(c, specimen.record, seed, seed)
    columns = specimen.record({site: sizes}, sent, seed)
    excitation, recording = folder / EXCITATION_FILE, folder / RECORDING_FILES[0]
    write_recording(excitation, columns[TIME], sent)
    read = {k: v for k, v in columns.items() if k != TIME}
    write_recording(recording, columns[TIME], read, machine.meta(c))
    fault, off = machine.faults[site], specimen.true_parameters
    values = ",".join(f"{k}={v:.6g}" for k, v in specimen.shown_values(site, sizes).items())
    truth = WithheldFile(
        seed=seed,
        effect=site.partition("@")[0],
        family=fault.family,
        as_simulated=(f"{site}:{values}",),
        parameters={k: true for k, (true, _) in off.items()},
        over_data_sheet={k: true / sheet for k, (true, sheet) in off.items() if sheet},
    )
    write_json(folder / TRUTH_FILE, truth.as_json())
    return recording


def run_demo(
    run: Run,
    *,
    seed: int,
    jobs: int,
    duration_s: float,
    rig: str = DEMO_RIG,
    progress: Progress = silent,
) -> dict[str, Any]:
    """Everything into a fresh run folder: recording, diagnosis, network (of the joint), report
    page. Returns pamid.demo/1; rig: a name, or the path of a file, which is run."""
    joint = rig == DEMO_RIG
    progress(f"recording a virtual {'joint' if joint else 'machine'}")
    run.claim(EXCITATION_FILE, TRUTH_FILE, *RECORDING_FILES)
    recording = (
        write_demo_recording(run.folder, draw_withheld(seed), seed=seed, duration_s=duration_s)
        if joint
        else write_rig_recording(run.folder, machine_of(rig), seed=seed)
    )
    run.finish()
    # noted as the command that does just this: with another --output anyone can repeat it
    words = ["pamid", "diagnose", str(recording), "--rig", rig, "--output", str(run.folder)]
    diagnosis = diagnose(
        recording,
        rig,
        seed=seed,
        jobs=jobs,
        output=run,
        progress=progress,
        command=[*words, "--seed", str(seed), "--jobs", str(jobs)],
    ).to_dict()
    network = None
    if joint:
        options = f"--iterations {ITERATIONS} --seed {seed}".split()
        trained = train_residual(
            run.folder,
            iterations=ITERATIONS,
            seed=seed,
            progress=lambda text: progress(f"training a network, step {text}"),
            command=["pamid", "train-residual", str(run.folder), *options],
        )
        if trained.interrupted:
            raise KeyboardInterrupt
        network = trained.to_dict()["mae"]
    progress("writing the page")
    report = write_report(run.folder)
    truth = read_json(run.path(TRUTH_FILE))
    return DemoOutput(
        withheld=truth,
        hit=hit(truth, diagnosis),
        verdict=diagnosis["verdict"],
        sentence=diagnosis["sentence"],
        causes=diagnosis["causes"],
        parameters={k: v for k, v in diagnosis["parameters"].items() if k in truth["parameters"]},
        how_far=diagnosis["how_far"],
        network=network,
        page=str(report.page),
    ).as_json()


def hit(truth: dict[str, Any], diagnosis: dict[str, Any]) -> Hit:
    """ "right" where the verdict names the withheld family alone, "among" where it is among
    several, else "missed"."""
    families = {c["family"] for c in diagnosis["causes"]}
    if truth["family"] not in families:
        return "missed"
    return "right" if families == {truth["family"]} else "among"
