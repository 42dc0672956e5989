"""Notebooks as pages, with the outputs that `make notebooks` gave them."""

from __future__ import annotations

import shutil
from pathlib import Path

NOTEBOOKS = Path(__file__).parents[2] / "notebooks"
HEAD = """(notebooks)=
# Notebooks

Each goes from a question to its answer; they are in `notebooks/` of the repository and run there as they stand, without
a robot.

```{toctree}
:maxdepth: 1

"""


def write_notebooks(folder: Path) -> None:
    """Copy the notebooks to a folder, beside a list of them."""
    folder.mkdir(parents=True, exist_ok=True)
    notebooks = sorted(NOTEBOOKS.glob("*.ipynb"))
    for notebook in notebooks:
        shutil.copyfile(notebook, folder / notebook.name)
    names = "\n".join(notebook.stem for notebook in notebooks)
    (folder / "index.md").write_text(f"{HEAD}{names}\n```\n", encoding="utf-8")
