"""Residuals of a fitted model, and networks that correct it at the output or at a port."""
