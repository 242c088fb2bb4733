"""The ground: errors, safe files, units, small numbers; knows nothing of rigs. `schemas` are the
models of the JSON, `parallel` shares work."""
