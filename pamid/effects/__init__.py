"""The catalogue: a file per effect. Dropping in a file adds it everywhere."""
