"""Models that people have already, as rigs: read with the simulator's own loader."""
