"""The two nouns, rig and effect, and the mechanism, ports: from equations to a runnable
model."""
