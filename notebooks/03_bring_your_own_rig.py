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
# `data/rigs/cart.py`; copy it and change it. This story uses it from the command line only, as
# somebody would who never reads pamid's own code: look at the file, check it, record, diagnose.
# Where the public measurements of a motor drive (EMPS) lie beside the project, it ends with those:
# a real machine.

# %%
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent if "__file__" in globals() else Path.cwd()
ROOT = HERE.parent
CART, EMPS = ROOT / "data" / "rigs" / "cart.py", ROOT / "data" / "rigs" / "emps.py"
MEASURED = ROOT.parent / "shared" / "data" / "emps"
temporary = tempfile.TemporaryDirectory()
folder = Path(temporary.name)


def pamid(*words: str | Path) -> dict[str, Any]:
    """Run a command; its JSON answer. A refusal ends the story with pamid's own words."""
    done = subprocess.run(
        [sys.executable, "-m", "pamid_cli", *map(str, words), "--json"],
        cwd=folder,
        capture_output=True,
        text=True,
    )
    answer = json.loads(done.stdout)
    if done.returncode:
        raise SystemExit(f"{answer.get('message', answer)} {answer.get('hint', '')}")
    return answer


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
for finding in pamid("check", CART)["findings"]:
    print(f"{'ok' if finding['ok'] else 'wrong':6s} {finding['check']}: {finding['detail'][:100]}")

# %% [markdown]
# ## 3. A recording
#  Here a virtual cart of 1.2 kg whose rail has 0.8 N of dry friction that the file does not know. A
# real one needs a CSV with the columns `time_s`, `force_n`, `position_m`.

# %%
pamid(
    "generate-aprbs",
    "--column",
    "force_n",
    "--duration",
    "30",
    "--amplitude",
    "3",
    "--hold",
    "0.2",
    "0.8",
    "--seed",
    "1",
    "--output",
    "excitation.csv",
)
pamid(
    "simulate",
    "--rig",
    CART,
    "--excitation",
    "excitation.csv",
    "--effect",
    "coulomb-friction:force_n=0.8",
    "--set",
    "mass_kg=1.2",
    "--seed",
    "2",
    "--output",
    "cart.csv",
)

# %% [markdown]
# ## 4. The diagnosis
#  The general catalogue attaches by the *kind* of a port, so a carriage force in newtons gets the
# same friction, drag and stiffness as a joint torque, in its own unit.


# %%
def tell(found: dict[str, Any]) -> None:
    """Sentence, causes, parameters, runners-up."""
    print(found["sentence"])
    for cause in found["causes"]:
        print(
            "  cause",
            cause["effect"],
            {
                k: f"{v['value']:.4g} ({v['low']:.4g} .. {v['high']:.4g})"
                for k, v in cause["parameters"].items()
            },
        )
    for name, p in found["parameters"].items():
        print(f"  {name} = {p['value']:.4g} ({p['low']:.4g} .. {p['high']:.4g})")
    for one in found["ranking"][:6]:
        print(
            f"  {one['effect']:22s} {one['family']:12s} removes {one['shrinkage']:7.1%} "
            f"({one['low']:.1%} .. {one['high']:.1%}) of the held-out error"
        )


tell(pamid("diagnose", "cart.csv", "--rig", CART, "--output", "cart-run"))

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
    tell(
        pamid(
            "diagnose",
            MEASURED / "estimation.csv",
            "--held-out",
            MEASURED / "pulses.csv",
            "--rig",
            EMPS,
            "--output",
            "emps-run",
        )
    )
else:
    print(f"skipped: no measurements at {MEASURED.name} beside the project")

# %%
temporary.cleanup()
