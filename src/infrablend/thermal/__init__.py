"""Physics of the thermal band and of its cameras, in plain numpy. Empty so far: the look is the paper's artistic one."""
