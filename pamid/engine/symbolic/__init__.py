"""Expressions of equations, their derivatives and their memory."""
