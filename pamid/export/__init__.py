"""Identified models out: C, FMU, ONNX, MATLAB."""
