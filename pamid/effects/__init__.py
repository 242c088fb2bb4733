"""The catalogue: one file per effect. Dropping in a file adds it everywhere."""
