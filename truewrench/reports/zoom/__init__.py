"""Figures that can be zoomed in the page, drawn by plotly.js, which the page carries with it."""
