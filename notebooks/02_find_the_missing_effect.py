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
# # Find the missing effect
#  The joint on the bench has dry friction in its bearing and chain; the model knows only viscous
# friction. The story withholds that from the diagnosis, asks where the gap lies, which effect
# causes it and how far it shrinks, and then looks at what a tempting wrong answer would have done.

# %%
import tempfile
from pathlib import Path

import numpy as np
import pandas

import pamid

temporary = tempfile.TemporaryDirectory()
folder = Path(temporary.name)
PERIOD_S = 0.003

# %% [markdown]
# ## 1. A joint with something withheld
#  0.4 N m of Coulomb friction, and two parameters off their data sheet, so that refitting alone has
# something to do.

# %%
TORQUE_N_M = 0.4
SPECIMEN = {"damping_m2_s": 7e-4, "scale": 1.10}
reference_deg = pamid.aprbs(20.0, PERIOD_S, amplitude=40.0, hold_s=(0.4, 1.6), seed=1)
time_s = PERIOD_S * np.arange(reference_deg.size)
recording = pamid.simulate(
    pandas.DataFrame({"time_s": time_s, "reference_deg": reference_deg}),
    rig="one-dof",
    effects=[f"coulomb-friction:torque_n_m={TORQUE_N_M}"],
    known={"inertia_kg_m2": 0.0896},
    parameters=SPECIMEN,
    seed=2,
)

# %% [markdown]
# ## 2. Ask
#  Every effect of the catalogue that fits a port of this rig is a candidate. All are screened; the
# promising ones are refitted *together with all parameters* and replayed on windows that no fit has
# seen. Each half of these windows is reported with the model that the other half would have chosen.
# A cause is named with the share of the gap that it removes and its probability, and what remains
# with its size.

# %%
run = pamid.diagnose(recording, rig="one-dof", jobs=2, progress=False)
print(run)
print("truth:", TORQUE_N_M, "N m")
print("this recording cannot separate:", ", ".join(run.tied))
run

# %%
run.plot_worst_window()

# %% [markdown]
# ## 3. The page
#  One file, no network needed; the figures lie beside it as PNG. This is the ranking of a run like
# this one:
#
# ![candidates and the share of the held-out error that each removes](pictures/joint-ranking.png)

# %%
report = pamid.report(run.save(folder / "run"))
print(
    f"{report.page.name}: {report.page.stat().st_size / 1000:.0f} kB; figures: "
    f"{', '.join(sorted(p.name for p in report.figures))}"
)

# %% [markdown]
# ## 4. What a tempting wrong effect would have done
#  Friction between the threads of the muscle's braid also makes loops. Looked at through the angle
# alone it does almost as well as the true cause, and anyone who tried only this one would have been
# content. Two things give it away. The muscle forces, held out as well, agree no better than
# without it. And the parameters: without any dry friction the fit makes up for it with viscous
# friction, ten times the specimen's 0.02 N m s, and the wrong effect leaves it about there.
# Refitting absorbs structure, and the numbers become fiction.

# %%
print(
    f"{'model':18s} {'angle MAE':>12s} {'force 1 MAE':>12s} {'viscous (truth 0.02)':>22s} "
    f"{'scale (truth 1.1)':>18s}"
)
for name in ("", "thread-friction", "coulomb-friction"):
    fit = pamid.fit(recording, rig="one-dof", effects=[name] if name else [], progress=False)
    angle, force = fit.errors["angle_deg"], fit.errors["force_1_n"]
    print(
        f"{name or 'refitted only':18s} {angle.refitted:8.3g} deg {force.refitted:10.3g} N "
        f"{fit.parameters['viscous_n_m_s'].value:22.3g} {fit.parameters['scale'].value:18.4g}"
    )
print(f"{'noise floor':18s} {angle.noise_floor:8.3g} deg {force.noise_floor:10.3g} N")

# %%
temporary.cleanup()
