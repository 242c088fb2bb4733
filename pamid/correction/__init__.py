"""What a fitted model leaves over, and networks that correct it at the output or at a port."""
