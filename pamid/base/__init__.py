"""The ground: errors, safe files, units, small numbers; knows nothing of rigs."""
