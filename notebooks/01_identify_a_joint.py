# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Identify a joint
#  A joint is pulled by two pneumatic muscles. Its data sheet gives twelve numbers or so; the
# specimen on the bench has others. This story makes a virtual specimen whose numbers are known,
# records it as a bench would, fits the model to the recording and asks how far each fitted number
# can be trusted.

# %%
import tempfile
from pathlib import Path

import numpy as np

from pamid import Recording
from pamid.estimation.fit_files import fit_json
from pamid.estimation.grey_box import GreyBox, fit_model
from pamid.excitation.aprbs import aprbs, coverage
from pamid.model.registry import rig_named
from pamid.recording.recording import read_recording, write_recording
from pamid.simulation.data_split import split_recordings
from pamid.simulation.virtual_rig import simulate_virtual_rig

temporary = tempfile.TemporaryDirectory()
folder = Path(temporary.name)
PERIOD_S = 0.003

# %% [markdown]
# ## 1. What to do with the joint
#  Steps of random height and random length (an amplitude-modulated pseudo-random signal, APRBS):
# many levels, so that a curve shows its shape; short and long holds, so that fast and slow dynamics
# both speak. `coverage` says what the signal cannot bring to light, before anybody stands at the
# bench.

# %%
reference_deg = aprbs(20.0, PERIOD_S, amplitude=40.0, hold_s=(0.4, 1.6), seed=1)
time_s = PERIOD_S * np.arange(reference_deg.size)
for sentence in coverage(reference_deg, PERIOD_S, span=(-40.0, 40.0)).sentences():
    print(" ", sentence)

# %% [markdown]
# ## 2. A specimen, and its recording
#  The arm's inertia is known from a pendulum test, so the recording states it and no fit will touch
# it. Five other numbers differ from the data sheet; nobody is told. The sensors are noisy (0.05
# deg, 1 kPa, 3 N), and the loop is closed: a controller turns reference and measured angle into the
# valve command.

# %%
KNOWN = {"inertia_kg_m2": 0.0896}
SPECIMEN = {
    "damping_m2_s": 7.5e-4,
    "scale": 1.10,
    "conductance_in_m3_per_s_pa": 4.2e-9,
    "viscous_n_m_s": 0.08,
    "contraction_0": 0.103,
}
write_recording(folder / "excitation.csv", time_s, {"reference_deg": reference_deg})
made = simulate_virtual_rig(
    "one-dof", read_recording(folder / "excitation.csv"), (), KNOWN, SPECIMEN, 1.0, seed=2
)
write_recording(folder / "joint.csv", time_s, made.columns, made.meta)
recording = read_recording(folder / "joint.csv")
print(f"{len(recording)} samples of {', '.join(recording.columns)}; known: {recording.known}")

# %% [markdown]
# ## 3. Fit
#  The model is driven by the *recorded command*, not by its own controller: in a closed loop the
# controller hides most of what is wrong with a model. The first 70 % are fitted, the last 30 % only
# judge. Every parameter gets an interval of 95 % and a word:
#
# - **settled**: the recording left less than 30 % of the prior's uncertainty;
# - **weak**: between 30 and 90 %: the prior still speaks, the number is half measured and half
# believed;
# - **silent**: more than 90 %: the recording says nothing, the number is the data sheet's.

# %%
rig = rig_named("one-dof")
sheet = {p.outside_name: p.value for p in rig.parameters}


def identify(measured: Recording) -> tuple[GreyBox, dict[str, str]]:
    """Fit, print parameters beside the truth, return the model and the word of every parameter."""
    model = fit_model(split_recordings(rig, [measured], []))
    found = fit_json(model, seed=0)
    inside = 0
    print(
        f"{'parameter':28s} {'data sheet':>11s} {'truth':>11s} {'fitted':>11s} {'95 %':>25s}  word"
    )
    for name, p in found["parameters"].items():
        truth = SPECIMEN.get(name, sheet[name])
        inside += p["low"] <= truth <= p["high"]
        print(
            f"{name:28s} {p['prior']:11.4g} {truth:11.4g} {p['value']:11.4g} "
            f"{p['low']:11.4g} .. {p['high']:10.4g}  {p['word']}"
        )
    print(f"{inside} of {len(found['parameters'])} intervals hold the truth")
    for channel, mae in found["mae"].items():
        print(
            f"  held-out MAE {channel:15s} data sheet {mae['data_sheet']:8.3g}   refitted "
            f"{mae['refitted']:8.3g}   "
            f"noise floor {mae['noise_floor']:8.3g}"
        )
    return model, {name: p["word"] for name, p in found["parameters"].items()}


complete, words = identify(recording)

# %% [markdown]
# The refitted error stands at the noise floor: for this joint the equations are right, and
# refitting is all there is to do. With an effect missing it would not get there; that is the next
# story.
#
# ## 4. The same joint without pressure and force sensors
#  Many benches measure the angle only. The fit still runs, with what is there. What it can no
# longer tell, it says: words drop from settled to weak or silent, and intervals widen: from the
# angle alone the strength of the muscle, its zero and the valves can stand in for one another. The
# count below says whether the intervals widen enough. They take the model as right; where an effect
# is missing (next story) they are narrow around wrong numbers.

# %%
kept = {name: made.columns[name] for name in ("command", "reference_deg", "angle_deg")}
write_recording(folder / "angle_only.csv", time_s, kept, made.meta)
poor, poor_words = identify(read_recording(folder / "angle_only.csv"))
lost = [name for name in words if words[name] == "settled" and poor_words[name] != "settled"]
print(f"settled with all sensors, no longer with the angle alone: {', '.join(lost) or 'none'}")

# %%
temporary.cleanup()
