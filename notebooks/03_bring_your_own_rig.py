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
# # Bring your own rig
#  A rig is one Python file. The smallest whole one, a cart on a rail pushed by a measured force, is
# `data/rigs/cart.py`; copy it and change it. In a notebook the class can stand in a cell as well:
# wherever a rig is asked for, a name, a path (the file is run) or a `pamid.Rig` will do. This story
# looks at the file, checks it, records and diagnoses.
# Where the public measurements of a motor drive (EMPS) lie beside the project, it ends with those:
# a real machine.

# %%
from pathlib import Path

import numpy as np
import pandas

import pamid

HERE = Path(__file__).resolve().parent if "__file__" in globals() else Path.cwd()
ROOT = HERE.parent
CART, EMPS = ROOT / "data" / "rigs" / "cart.py", ROOT / "data" / "rigs" / "emps.py"
MEASURED = ROOT.parent / "shared" / "data" / "emps"

# %% [markdown]
# ## 1. The file
#  Inputs and outputs are columns of a recording; ports are where physics may be added; `rates` and
# `measure` are the equations. That is all there is to write: derivatives, compilation and the
# fitting effects come from this.

# %%
print(CART.read_text())

# %% [markdown]
# ## 2. Check it before measuring anything

# %%
checked = pamid.check(CART)
print(checked.summary())
checked

# %% [markdown]
# ## 3. A recording
#  Here a virtual cart of 1.2 kg whose rail has 0.8 N of dry friction that the file does not know. A
# real one needs a CSV with the columns `time_s`, `force_n`, `position_m`.

# %%
PERIOD_S = 0.003
force_n = pamid.aprbs(30.0, PERIOD_S, amplitude=3.0, hold_s=(0.2, 0.8), seed=1)
recording = pamid.simulate(
    pandas.DataFrame({"time_s": PERIOD_S * np.arange(force_n.size), "force_n": force_n}),
    rig=CART,
    effects=["coulomb-friction:force_n=0.8"],
    parameters={"mass_kg": 1.2},
    seed=2,
)
print(recording)
recording.plot()

# %% [markdown]
# ## 4. The diagnosis
#  The general catalogue attaches by the *kind* of a port, so a carriage force in newtons gets the
# same friction, drag and stiffness as a joint torque, in its own unit.

# %%
run = pamid.diagnose(recording, rig=CART, progress=False)
print(run)
print(run.parameters)
for one in run.ranking[:6]:
    print(
        f"  {one.effect:22s} {one.family:12s} removes {one.shrinkage:7.1%} "
        f"({one.low:.1%} .. {one.high:.1%}) of the held-out error"
    )
run

# %% [markdown]
# ## 5. A real drive
#  EMPS: a carriage on a motor-driven screw, 1 kHz, two experiments; the second is held out.
# Published values: mass 95.11 kg, viscous friction 203.5 N s/m, Coulomb friction 20.39 N, offset
# -3.16 N. The rig file knows mass, viscous friction and offset only. (Where to get the
# measurements: `data/README.md`.)
#  ![candidates for the drive and the share of the held-out error that each
# removes](pictures/emps-ranking.png)

# %%
if MEASURED.is_dir():
    drive = pamid.diagnose(
        MEASURED / "estimation.csv",
        rig=EMPS,
        held_out=MEASURED / "pulses.csv",
        progress=False,
        warn=print,
    )
    print(drive)
    print(drive.parameters)
else:
    print(f"skipped: no measurements at {MEASURED.name} beside the project")
