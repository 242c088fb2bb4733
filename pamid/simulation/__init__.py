"""Models run over recordings: simulation, windows, replay, the parts of the data; `excitation`
makes the signals."""
