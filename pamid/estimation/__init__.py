"""Parameters from recordings: fit, weights, priors, intervals, combinations."""
