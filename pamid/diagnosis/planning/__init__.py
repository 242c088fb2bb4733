"""Experiments: which effects an experiment would show or confuse before it is made, and which comes
next."""
