"""The machines of the trial, one file per rig, found by scanning this folder."""
