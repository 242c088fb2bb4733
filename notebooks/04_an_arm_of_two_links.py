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
# # An arm of two links
#  Two links hang in a vertical plane, four pneumatic muscles turn the joints. The masses come from
# weighing and CAD and are 15 to 25 % off, as they are for a real arm before anybody has thought of
# the muscles and chains that ride on it. This story lets the arm swing by itself, asks what a swing
# can tell and what it cannot, and sends pulses to the valves. It is told in commands, as a shell
# would take them.

# %%
import json
import os
import shlex
import tempfile
from pathlib import Path

from pamid_cli.frame import run

temporary = tempfile.TemporaryDirectory()
os.chdir(temporary.name)
SPECIMEN = {
    "link_1_mass_kg": 2.60,
    "link_1_centre_m": 0.23,
    "link_1_inertia_kg_m2": 0.049,
    "link_2_mass_kg": 0.58,
    "link_2_centre_m": 0.155,
    "link_2_inertia_kg_m2": 0.0060,
    "viscous_1_n_m_s": 0.16,
    "viscous_2_n_m_s": 0.03,
    "conductance_out_m3_per_s_pa": 4.2e-9,
    "scale": 1.08,
    "damping_m2_s": 5e-4,
}
HIDDEN = " ".join(f"--set {name}={value}" for name, value in SPECIMEN.items())


def pamid(line: str) -> None:
    """One command line; it has to end well."""
    print(f"$ pamid {line.replace(HIDDEN, '--set ...')}")
    code = run(shlex.split(line))
    if code:
        raise SystemExit(code)


# %% [markdown]
# ## 1. Let it swing
#  The vents stand open, the muscles are limp, the arm is let go: no valve and no muscle takes part,
# only links, gravity and bearings. One release is fitted, another, from other angles, is held out.

# %%
for name, release, seed in (("swing", "30 40", 1), ("other_swing", "-25 35", 2)):
    pamid(
        f"generate-aprbs --rig two-link --experiment gravity-test --release {release} --duration 9 "
        f"--output {name}_sent.csv"
    )
    pamid(f"simulate --excitation {name}_sent.csv {HIDDEN} --seed {seed} --output {name}.csv")
pamid("fit swing.csv --held-out other_swing.csv --rig two-link --output swung")

# %% [markdown]
# The held-out error of both angles stands at the noise floor. And yet no mass is known: a pendulum
# twice as heavy swings alike. Under the table stands what *is* known, and of what it is made.

# %%
swung = json.loads(Path("swung/fit.json").read_text())
for channel in ("angle_1_deg", "angle_2_deg"):
    mae = swung["mae"][channel]
    print(
        f"{channel}: {mae['data_sheet']:.2f} data sheet, {mae['refitted']:.4f} refitted, "
        f"{mae['noise_floor']:.4f} noise floor"
    )
    assert mae["refitted"] < 1.05 * mae["noise_floor"]
assert {"link_1_mass_kg", "link_2_mass_kg"} <= {
    name for tie in swung["tied"] for name in tie["parameters"]
}

# %% [markdown]
# ## 2. Hang something on it
#  A payload of known mass gives the scale. The second fit begins where the first ended, with all
# that it knew: `--from` carries the whole posterior over, combinations included.

# %%
pamid(
    "generate-aprbs --rig two-link --experiment gravity-test --release 20 -30 --payload 0.5 "
    "--duration 9 "
    "--output loaded_sent.csv"
)
pamid(f"simulate --excitation loaded_sent.csv {HIDDEN} --seed 3 --output loaded.csv")
pamid("fit loaded.csv --rig two-link --from swung --output weighed")

# %%
weighed = json.loads(Path("weighed/fit.json").read_text())["combinations"]["first_moment_2_kg_m"]
truth = SPECIMEN["link_2_mass_kg"] * SPECIMEN["link_2_centre_m"] + 0.5 * 0.30
print(
    f"first moment of link 2 with its payload: {weighed['low']:.4f} .. {weighed['high']:.4f} kg "
    f"m, truth {truth:.4f}"
)
assert abs(weighed["value"] / truth - 1.0) < 0.02

# %% [markdown]
# ## 3. Pulses for the valves
#  Each muscle in turn is vented in pulses of 30 to 500 ms. What the links weigh is known by now;
# the pulses settle conductances, damping and force. The last 30 % of the pulses would be one muscle
# alone, so the same pulses are recorded once more to be held out.

# %%
pamid("generate-aprbs --rig two-link --experiment valve-pulses --output pulses_sent.csv")
pamid(f"simulate --excitation pulses_sent.csv {HIDDEN} --seed 4 --output pulses.csv")
pamid(f"simulate --excitation pulses_sent.csv {HIDDEN} --seed 5 --output more_pulses.csv")
pamid("fit pulses.csv --held-out more_pulses.csv --rig two-link --from weighed --output arm")
settled = json.loads(Path("arm/fit.json").read_text())["parameters"]
for name in ("scale", "damping_m2_s", "conductance_out_m3_per_s_pa"):
    p = settled[name]
    print(f"{name}: {p['low']:.4g} .. {p['high']:.4g} ({p['word']}), truth {SPECIMEN[name]:g}")
    assert p["word"] == "settled" and abs(p["value"] / SPECIMEN[name] - 1.0) < 0.05

# %% [markdown]
# `pamid report arm` shows all of it, with the arm moving: measured over simulated. What is left for
# a diagnosis, a dry elbow or a leaking muscle, `pamid diagnose rec.csv --rig two-link` names with
# its place: `coulomb-friction@joint_2`, `leak@pressure_21`. That takes minutes and is left to you.

# %%
os.chdir("/")
temporary.cleanup()
