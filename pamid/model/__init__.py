"""The two nouns, rig and effect, and the one mechanism, ports: from equations to a runnable
model."""
