"""Experiments: which effects one would show or confuse before it is made, and which comes next."""
