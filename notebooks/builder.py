"""Builds the notebooks: `python notebooks/builder.py [NAME...]` executes `source/NAME.py` and writes `NAME.ipynb`.

The scripts in `source`, in percent format, are what is edited; the notebooks are made from them, with their outputs.
"""

from __future__ import annotations

import sys
from pathlib import Path

import jupytext
import nbformat
from nbclient import NotebookClient

FOLDER = Path(__file__).parent
SOURCES = FOLDER / "source"
TIME_LIMIT = 300
"""Of one cell, s."""
PICTURES = """
%matplotlib inline
%config InlineBackend.print_figure_kwargs = {"bbox_inches": None, "dpi": 110}
"""
"""Executed first and not kept: pictures as PNG, of fewer bytes than SVG."""
KERNEL = {"display_name": "Python 3", "language": "python", "name": "python3"}


def notebook_of(source: Path) -> nbformat.NotebookNode:
    """The notebook of a script, without outputs; its cells are numbered, so that building it again changes nothing."""
    notebook = jupytext.read(source)
    for number, cell in enumerate(notebook.cells):
        cell["id"] = f"cell-{number}"
    notebook["metadata"] = {"kernelspec": KERNEL, "language_info": {"name": "python"}}
    return notebook


def executed(notebook: nbformat.NotebookNode) -> nbformat.NotebookNode:
    """The notebook with the outputs of its cells, executed in this folder; raises when a cell does."""
    notebook.cells.insert(0, nbformat.v4.new_code_cell(PICTURES))
    client = NotebookClient(
        notebook,
        timeout=TIME_LIMIT,
        kernel_name="python3",
        record_timing=False,
        resources={"metadata": {"path": str(FOLDER)}},
    )
    client.execute()
    del notebook.cells[0]
    for number, cell in enumerate(c for c in notebook.cells if c.cell_type == "code"):
        cell["execution_count"] = number + 1
        for output in cell.outputs:
            _tidy(output, number + 1)
    return notebook


def _tidy(output: nbformat.NotebookNode, count: int) -> None:
    """Number an output, and keep one picture of each."""
    if "execution_count" in output:
        output["execution_count"] = count
    if "image/png" in output.get("data", {}):
        output["data"].pop("image/svg+xml", None)


def main(names: list[str]) -> None:
    """Build the notebooks of these names, or all."""
    for source in sorted(SOURCES.glob("*.py")):
        if not names or source.stem in names:
            nbformat.write(executed(notebook_of(source)), FOLDER / f"{source.stem}.ipynb")
            print(f"notebooks/{source.stem}.ipynb")


if __name__ == "__main__":
    main(sys.argv[1:])
