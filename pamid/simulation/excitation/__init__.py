"""Signals that are sent to a rig, experiments made of them, and the files they are written to."""
