"""Export of identified models: C, FMU, ONNX, MATLAB, MJCF, URDF."""
