"""Style sheet of sketches, for the page that shows them: the ink is the colour of the text, the effect stands out."""

from __future__ import annotations

SKETCH_STYLE = """
.sketch { width: 100%; max-width: 240px; height: auto; display: block; color: inherit; }
.sketch path, .sketch circle { fill: none; stroke: currentColor; stroke-width: 1.4; stroke-linejoin: round;
  stroke-linecap: round; }
.sketch .faint { stroke-width: 0.9; opacity: 0.5; }
.sketch .ghost { stroke-dasharray: 4 3; opacity: 0.6; }
.sketch .accent { stroke: var(--effect, #D55E00); stroke-width: 1.8; }
.sketch .joint { fill: var(--paper, #fff); }
.sketch .dot { fill: currentColor; }
.sketch .accent.dot { fill: var(--effect, #D55E00); }
.sketch text { font: 11px sans-serif; fill: currentColor; opacity: 0.85; }
.sketch .parameter { fill: var(--effect, #D55E00); font-style: italic; font-weight: 600; opacity: 1; }
"""
