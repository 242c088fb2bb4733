"""Parameters and latent values from recordings: fit, weights, priors, intervals, smoothing."""
