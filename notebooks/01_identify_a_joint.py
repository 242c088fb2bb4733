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
import numpy as np
import pandas

import pamid

PERIOD_S = 0.003

# %% [markdown]
# ## 1. What to do with the joint
#  Steps of random height and random length (an amplitude-modulated pseudo-random signal, APRBS):
# many levels, so that a curve shows its shape; short and long holds, so that fast and slow dynamics
# both speak. `coverage` says what the signal cannot bring to light, before anybody stands at the
# bench.

# %%
reference_deg = pamid.aprbs(20.0, PERIOD_S, amplitude=40.0, hold_s=(0.4, 1.6), seed=1)
time_s = PERIOD_S * np.arange(reference_deg.size)
excitation = pandas.DataFrame({"time_s": time_s, "reference_deg": reference_deg})
for sentence in pamid.coverage(reference_deg, PERIOD_S, span=(-40.0, 40.0)).sentences():
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
recording = pamid.simulate(
    excitation, rig="one-dof", known=KNOWN, parameters=SPECIMEN, noise=1.0, seed=2
)
print(recording, recording.known)
recording.plot(["reference_deg", "angle_deg", "pressure_1_kpa", "force_1_n"])

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
complete = pamid.fit(recording, rig="one-dof", progress=False)


def held_against_the_truth(fit: pamid.FitResult) -> None:
    """Every parameter beside the truth; how many intervals hold it."""
    inside = 0
    for name, p in fit.parameters.items():
        truth = SPECIMEN.get(name, p.prior)
        inside += p.low <= truth <= p.high
        print(f"{name:28s} truth {truth:11.4g}   {p.value:11.4g} ({p.low:.4g} .. {p.high:.4g})")
    print(f"{inside} of {len(fit.parameters)} intervals hold the truth")


held_against_the_truth(complete)
print(complete)
complete

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
angle_only = recording.to_pandas()[["time_s", "command", "reference_deg", "angle_deg"]]
poor = pamid.fit(
    pamid.Recording.from_pandas(
        angle_only,
        "angle-only",
        loop="closed",
        known=KNOWN,
        controller=recording.controller,
    ),
    rig="one-dof",
    progress=False,
)
held_against_the_truth(poor)
lost = [
    name
    for name, p in complete.parameters.items()
    if p.word == "settled" and poor.parameters[name].word != "settled"
]
print(f"settled with all sensors, no longer with the angle alone: {', '.join(lost) or 'none'}")
poor
