"""Pages of the catalogue: one of each effect, made in two processes, and the list of them by stage."""

from __future__ import annotations

import os
from concurrent.futures import ProcessPoolExecutor
from itertools import groupby
from multiprocessing import get_context
from pathlib import Path

from docs.generator.effect_page import SENSORS, write_effect_page
from modeling.chain.chain import Stage
from modeling.chain.effect import Effect
from modeling.effects import CATALOGUE, catalogue, named

PROCESSES = 2


def write_catalogue(folder: Path) -> None:
    """Write the page of every effect, and the index."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "index.md").write_text(catalogue_index(), encoding="utf-8")
    for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ[variable] = "1"
    with ProcessPoolExecutor(PROCESSES, mp_context=get_context("spawn")) as pool:
        list(pool.map(_write, [effect.id for effect in CATALOGUE], [folder] * len(CATALOGUE)))


def _write(effect_id: str, folder: Path) -> None:
    write_effect_page(named(effect_id), folder)


def catalogue_index() -> str:
    """The effects by stage of the chain from motion to reading, each with a link to its page."""
    lines = [INTRODUCTION.format(count=len(CATALOGUE))]
    for stage, effects in groupby(by_stage(), key=lambda e: e.stage.value):
        lines += [
            f"\n## {stage.capitalize()}\n",
            "| effect | what it is | sensor | parameters |",
            "|---|---|---|---|",
        ]
        lines += [_row(effect) for effect in effects]
    pages = "\n".join(effect.id for effect in by_stage())
    return "\n".join([*lines, f"\n```{{toctree}}\n:hidden:\n\n{pages}\n```\n"])


def by_stage() -> list[Effect]:
    """The catalogue in the order of the stages, from the joints to the reading."""
    stages = list(Stage)
    return sorted(catalogue(), key=lambda effect: stages.index(effect.stage))


def _row(effect: Effect) -> str:
    names = ", ".join(f"`{p.name}`" for p in effect.parameters(effect.spaces[0])[:4])
    more = ", .." if len(effect.parameters(effect.spaces[0])) > 4 else ""
    sensors = ", ".join(SENSORS[s] for s in effect.spaces)
    return f"| [`{effect.id}`](#effect-{effect.id}) | {effect.title} | {sensors} | {names}{more} |"


INTRODUCTION = """(catalogue)=
# Catalogue of effects

The rigid tool is a bias in each channel, a mass, its centre and its inertia. These {count} effects are what a rig may
have beside it, in the order in which they act on the way from the joints to the reading. Each page has the equation
with sign and units, pictures of what the effect leaves in the residual of a simulated rig, what it is confused with,
what to check on the rig and which motion provokes it. All of it is made from the code that fits and diagnoses, each
time the manual is built. An effect that is not here can be [written as formulas](../../guide/custom_effects.md).
"""
