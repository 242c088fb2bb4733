"""Expressions: what equations are written with, their derivatives and their memory."""
