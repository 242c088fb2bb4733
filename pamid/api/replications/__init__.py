"""The results of the two founding papers, and the demonstration, on virtual rigs."""
