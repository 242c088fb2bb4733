"""Equations to compiled simulation and exact sensitivities; nothing else in pamid knows numba or LLVM."""

from pamid.engine.homeless import settle_numba

settle_numba()     # before any module here is compiled
