"""Equations to compiled simulation and exact sensitivities; nothing else in pamid knows numba or
LLVM."""
