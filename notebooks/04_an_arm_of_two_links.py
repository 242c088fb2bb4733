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
# can tell and what it cannot, and sends pulses to the valves.

# %%
import pamid

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


def recorded(excitation: pamid.Recording, seed: int) -> pamid.Recording:
    """What the specimen's sensors show of an excitation."""
    return pamid.simulate(excitation, rig="two-link", parameters=SPECIMEN, seed=seed)


# %% [markdown]
# ## 1. Let it swing
#  The vents stand open, the muscles are limp, the arm is let go: no valve and no muscle takes part,
# only links, gravity and bearings. One release is fitted, another, from other angles, is held out.

# %%
swing = recorded(pamid.release_excitation("two-link", [30.0, 40.0], duration_s=9.0), seed=1)
other_swing = recorded(pamid.release_excitation("two-link", [-25.0, 35.0], duration_s=9.0), seed=2)
swung = pamid.fit(swing, rig="two-link", held_out=other_swing, progress=False)
print(swung)
print(swung.combinations)
swung

# %% [markdown]
# The held-out error of both angles stands at the noise floor. And yet no mass is known: a pendulum
# twice as heavy swings alike. `combinations` holds what *is* known.

# %%
for channel in ("angle_1_deg", "angle_2_deg"):
    error = swung.errors[channel]
    assert error.refitted < 1.05 * error.noise_floor
print({name: swung.parameters[name].word for name in ("link_1_mass_kg", "link_2_mass_kg")})

# %% [markdown]
# ## 2. Hang something on it
#  A payload of known mass gives the scale. The second fit begins where the first ended, with all
# that it knew: `earlier` carries the whole posterior over, combinations included.

# %%
loaded = recorded(
    pamid.release_excitation("two-link", [20.0, -30.0], payload_kg=0.5, duration_s=9.0), seed=3
)
weighed = pamid.fit(loaded, rig="two-link", earlier=swung, progress=False)
moment = weighed.combinations["first_moment_2_kg_m"]
truth = SPECIMEN["link_2_mass_kg"] * SPECIMEN["link_2_centre_m"] + 0.5 * 0.30
print(
    f"first moment of link 2 with its payload: {moment.low:.4f} .. {moment.high:.4f} kg m, "
    f"truth {truth:.4f}"
)
assert abs(moment.value / truth - 1.0) < 0.02

# %% [markdown]
# ## 3. Pulses for the valves
#  Each muscle in turn is vented in pulses of 30 to 500 ms. What the links weigh is known by now;
# the pulses settle conductances, damping and force. The last 30 % of the pulses would be one muscle
# alone, so the same pulses are recorded once more to be held out.

# %%
pulses = pamid.pulse_excitation("two-link")
arm = pamid.fit(
    recorded(pulses, seed=4),
    rig="two-link",
    held_out=recorded(pulses, seed=5),
    earlier=weighed,
    progress=False,
)
for name in ("scale", "damping_m2_s", "conductance_out_m3_per_s_pa"):
    p = arm.parameters[name]
    print(f"{name}: {p.low:.4g} .. {p.high:.4g} ({p.word}), truth {SPECIMEN[name]:g}")
    assert p.word == "settled" and abs(p.value / SPECIMEN[name] - 1.0) < 0.05
arm

# %% [markdown]
# `pamid.report(arm.save("arm"))` shows all of it, with the arm moving: measured over simulated.
# What is left for a diagnosis, a dry elbow or a leaking muscle, `pamid.diagnose(recording,
# rig="two-link")` names with its place: `coulomb-friction@joint_2`, `leak@pressure_21`. That takes
# minutes and is left to you.
