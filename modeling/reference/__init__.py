"""Chapter 22, "Characterization of the Dynamical Model of a Force Sensor for Robot Manipulators" (Bassi et al.), its
equations checked against the derivation; its authors: Bassi, Benzi, Capisani, Cuppone, Ferrara.

Nothing is computed with the printed equations; they are compared only.
"""

from modeling.reference.body_wrench import wrench_equations
from modeling.reference.contact_statics import contact_equations, printed_direction
from modeling.reference.equation import Equation, Equations, EquationVerdict, Errata, Erratum, ErratumProof, vanishes
from modeling.reference.path_kinematics import path_equations

__all__ = [
    "Equation",
    "EquationVerdict",
    "Equations",
    "Errata",
    "Erratum",
    "ErratumProof",
    "contact_equations",
    "path_equations",
    "printed_direction",
    "vanishes",
    "wrench_equations",
]
