"""Physics of the thermal band and its cameras, plain numpy. Empty so far: the look is the paper's artistic one."""
