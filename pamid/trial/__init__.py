"""The blind trial: virtual machines with separate equations, planted faults, and the scoring of the
diagnosis."""
