"""The machines of the trial, a file per rig, found by scanning this folder."""
