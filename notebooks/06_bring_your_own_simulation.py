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
# # Bring your own simulation
#  You have a MuJoCo model of a robot, and a log of the robot that it does not follow. Here the
# model is `reacher.xml`, an arm of two joints that ships with the package gymnasium, and the robot
# is a MuJoCo simulation of it with two secrets: its second joint rubs, and its first one is damped
# more than the file says. `pip install 'pamid[mujoco]' gymnasium` brings what this story needs.

# %%
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

import mujoco
import numpy as np
import pandas as pd

import pamid

package = find_spec("gymnasium")
MODEL = Path(package.submodule_search_locations[0]) / "envs" / "mujoco" / "assets" / "reacher.xml"
temporary = tempfile.TemporaryDirectory()
folder = Path(temporary.name)
FRICTION_NM, DAMPING_NM_S = 0.6, 1.3

# %% [markdown]
# ## 1. What becomes of the model
#  A tree of hinges and slides without contacts is written as equations; `check` says so, what it
# leaves out, and where effects can act.

# %%
checked = pamid.check(MODEL)
print("\n".join(line for line in checked.summary().splitlines() if "remark" in line))

# %% [markdown]
# ## 2. A log of the robot
#  A controller of the robot's own moves both joints between random angles; its commands are logged
# with the angles, as an encoder of 0.0001 rad shows them.


# %%
def drive(machine: mujoco.MjModel, seed: int, seconds: float = 40.0) -> pd.DataFrame:
    """Commands and angles of a machine under a controller, every 10 ms."""
    machine.opt.timestep = 0.001
    data, random = mujoco.MjData(machine), np.random.default_rng(seed)
    rows, wanted, until = [], np.zeros(2), 0.0
    for k in range(int(seconds / 0.01)):
        if k * 0.01 >= until:
            wanted, until = random.uniform(-1.2, 1.2, 2), until + random.uniform(0.4, 1.6)
        turning = data.qvel[:2]
        command = np.clip(0.05 * (wanted - data.qpos[:2]) - 0.012 * turning, -0.3, 0.3)
        angles = np.round(data.qpos[:2] / 1e-4) * 1e-4
        rows.append([k * 0.01, *command, *angles])
        data.ctrl[:] = command
        mujoco.mj_step(machine, data, 10)
    columns = ["actuator_0_command", "actuator_1_command"]
    columns += ["joint0_position_rad", "joint1_position_rad"]
    return pd.DataFrame(rows, columns=["time_s", *columns])


robot = mujoco.MjModel.from_xml_path(str(MODEL))
robot.dof_damping[0], robot.dof_frictionloss[1] = DAMPING_NM_S, FRICTION_NM
robot.dof_solref[:] = 0.002, 1.0  # rubs as a dry bearing does: at once, not from 0.1 rad/s on
log = drive(robot, seed=1)
log.head()

# %% [markdown]
# ## 3. What is missing in the model
#  The recorded commands are replayed on the model, its parameters are refitted, and every effect of
# the catalogue that fits is tried at every joint, command and sensor.

# %%
run = pamid.diagnose(log, rig=MODEL, jobs=2, progress=False)
print(run)
assert run.causes[0].family == "friction" and "joint1" in run.causes[0].effect
run

# %%
run.plot_worst_window()

# %% [markdown]
# ## 4. The model, written back
#  Identified values go into the model's own text, which keeps its comments and its order; what MJCF
# cannot hold is said.

# %%
run.save(folder / "run")
written = folder / "reacher-identified.xml"
command = [Path(sys.executable).with_name("pamid"), "export", folder / "run", "--rig", MODEL]
print(
    subprocess.run(
        [*command, "--to", "mjcf", "--output", written], check=True, capture_output=True, text=True
    ).stdout
)
print("\n".join(line for line in written.read_text().splitlines() if "joint1" in line))

# %% [markdown]
# ## 5. Does plain MuJoCo follow the robot now?
#  Another log, of which nothing has seen anything, and no pamid: the commands that were sent to the
# robot are sent to both models.


# %%
def miss(file: Path, seen: pd.DataFrame) -> float:
    """Mean error of the angles in plain MuJoCo, rad."""
    model = mujoco.MjModel.from_xml_path(str(file))
    model.opt.timestep = 0.001
    data, errors = mujoco.MjData(model), []
    for row in seen.itertuples(index=False):
        errors.append(np.abs(data.qpos[:2] - row[3:5]).mean())
        data.ctrl[:] = row[1:3]
        mujoco.mj_step(model, data, 10)
    return float(np.mean(errors))


fresh = drive(robot, seed=2, seconds=20.0)
before, after = miss(MODEL, fresh), miss(written, fresh)
print(f"mean error of the angles: {before:.3f} rad with the model, {after:.4f} rad as written back")
assert after < 0.2 * before

# %%
temporary.cleanup()
