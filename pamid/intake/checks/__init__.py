"""Faults of a recording, a rig or an effect, before anything is fitted."""
