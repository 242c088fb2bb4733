"""Before measuring: what an experiment would show of every effect, and what it would confuse."""
