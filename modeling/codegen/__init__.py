"""Code generation: the rigid tool's regressor and fitted models in C, NumPy, CasADi and LaTeX."""
