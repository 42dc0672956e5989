"""Style of sketches and equations on the manual's pages: the one of the reports."""

from __future__ import annotations

from pathlib import Path

from truewrench.effect_description import SKETCH_STYLE


def write_style_sheet(folder: Path) -> None:
    """Write `sketches.css` to the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "sketches.css").write_text(SKETCH_STYLE.strip() + "\n", encoding="utf-8")
