"""What every result has beside its table: text, figure, plain data and labelled arrays, made by the presenter."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from modeling.presenter import presenter

if TYPE_CHECKING:
    import xarray as xr


class Presented:
    """A result with a summary, a figure, plain data, and labelled arrays where it has dimensions."""

    def summary(self) -> str:
        """The result as text, with everything worth knowing about it."""
        return presenter().summary(self)

    def to_dict(self) -> dict[str, Any]:
        """The result as plain data that JSON can write: numbers are finite or None.

        Of a fit and of a model that `load` gave it is that of a model file, and `load` takes it.
        """
        return presenter().data(self)

    def to_xarray(self) -> xr.Dataset:
        """The result's arrays with named dimensions, coordinates and units; needs xarray.

        Raises
        ------
        InputError
            For a result without dimensions, and where xarray is not installed.
        """
        found: xr.Dataset = presenter().dataset(self)
        return found

    def plot(
        self, kind: str | None = None, *, channel: str | None = None, backend: str = "matplotlib", ax: Any = None
    ) -> Any:
        """The result as a figure, of matplotlib for print or of plotly for zooming; both show the same numbers.

        Parameters
        ----------
        kind : str, optional
            What to draw, where there are several kinds of figures; a wrong one is answered by those there are.
        channel : str, optional
            Channel of a figure of one channel, by default the worst.
        backend : str, optional
            "matplotlib", the default, or "plotly".
        ax : matplotlib.axes.Axes, or a sequence of them, optional
            Axes to draw on, by default a figure of its own: one gets the main panel, as many as there are panels get
            all.

        Returns
        -------
        matplotlib.figure.Figure or plotly.graph_objects.Figure
            Shown by a notebook; `figure.savefig("file.png")`, or of plotly `figure.write_html("file.html")`, writes it.

        Raises
        ------
        InputError
            For a result without a figure, and an unknown kind, channel, backend or axes.
        """
        return presenter().plot(self, kind=kind, channel=channel, backend=backend, ax=ax)
