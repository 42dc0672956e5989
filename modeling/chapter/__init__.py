"""The chapter, checked: its equations as printed, next to what this project derives.

Bassi, Benzi, Capisani, Cuppone, Ferrara, "Characterization of the Dynamical Model of a Force Sensor for Robot
Manipulators" (chapter 22). Nothing is computed with the printed equations; they are here to be compared.
"""

from modeling.chapter.contact import contact_equations
from modeling.chapter.equation import Equation, Verdict, vanishes
from modeling.chapter.erratum import Erratum, Proof
from modeling.chapter.path import path_equations
from modeling.chapter.table import Equations, Errata
from modeling.chapter.wrench import wrench_equations

__all__ = [
    "Equation",
    "Equations",
    "Errata",
    "Erratum",
    "Proof",
    "Verdict",
    "contact_equations",
    "path_equations",
    "vanishes",
    "wrench_equations",
]
