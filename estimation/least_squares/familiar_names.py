"""Attributes that fits of lmfit, SciPy, scikit-learn and statsmodels have, and what holds the same here."""

from __future__ import annotations

FAMILIAR_NAMES = {
    "redchi": "reduced_chi_square",
    "chisqr": "reduced_chi_square, per degree of freedom",
    "chi2": "reduced_chi_square, per degree of freedom",
    "covar": "covariance",
    "pcov": "covariance",
    "cov_params": "covariance",
    "correl": "correlation",
    "popt": "theta",
    "coef_": "values",
    "best_values": "values",
    "stderr": 'params["std"], or fit["m"].std of one parameter',
    "bse": 'params["std"], or fit["m"].std of one parameter',
    "std": 'params["std"], or fit["m"].std of one parameter',
    "best_fit": "predict()",
    "fittedvalues": "predict()",
    "residual": "residuals, of each recording",
    "resid": "residuals, of each recording",
    "conf_int": 'intervals(), and params[["low", "high"]]',
    "ci_report": "intervals()",
    "fit_report": "summary()",
    "success": "converged",
}
"""What holds it, by the other package's name."""


def unknown_attribute(kind: str, name: str) -> str:
    """Message for an attribute that a class `kind` has not."""
    missing = f"a {kind} has no attribute '{name}'"
    return f"{missing}; see {FAMILIAR_NAMES[name]}" if name in FAMILIAR_NAMES else missing
