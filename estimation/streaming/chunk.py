"""Chunk of a run with its motion derivatives, usable without the other samples."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimation.recordings.recording import Recording
from modeling.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Chunk:
    """Samples of one run: the wrench, and a model's input signals.

    Parameters
    ----------
    run : str
        The run it is part of: chunks of one run share its zero, and may come in any order.
    signals : mapping of str to array (n,)
        Signals by name, SI, as those of `Recording.signals`: phi, dphi, ddphi, ax, ay in the plane, for example.
    wrench : array (n, p)
        Readings in N and N m.
    history : int, optional
        Leading rows that serve only as past values of coloured noise; by default 0, as where the run begins.

    Raises
    ------
    InputError
        For columns of different lengths and for rows that are all history.

    Examples
    --------
    >>> import truewrench as tw
    >>> recording = tw.read("train.csv", rig=tw.Rig.read("rig.toml"))
    >>> whole = tw.Chunk(run="monday", signals=recording.signals, wrench=recording.wrench)
    >>> [(piece.history, len(piece.wrench)) for piece in whole.pieces(2000, overlap=20)]
    [(0, 2000), (20, 2020)]
    """

    run: str
    signals: Mapping[str, Array]
    wrench: Array
    history: int = 0

    def __repr__(self) -> str:
        rows = f"{len(self.wrench)} samples, {self.history} of them history"
        return f"Chunk of {self.run!r}: {rows}; {', '.join(self.signals)}"

    def __post_init__(self) -> None:
        samples = len(self.wrench)
        for name, column in self.signals.items():
            if np.shape(column) != (samples,):
                what = f"signal {name} has the shape {np.shape(column)} and the wrench {samples} rows"
                raise InputError(what=what, where=self.run, remedy="give one value of each signal per row")
        if not 0 <= self.history < samples:
            what = f"{self.history} of {samples} rows are history"
            raise InputError(what=what, where=self.run, remedy="give rows beyond the history")

    def part(self, start: int, end: int, history: int = 0) -> Chunk:
        """The samples from start to end, with their own history."""
        signals = {name: values[start:end] for name, values in self.signals.items()}
        return replace(self, signals=signals, wrench=self.wrench[start:end], history=history)

    def pieces(self, size: int, overlap: int) -> Iterator[Chunk]:
        """The samples after the history in pieces of `size`, with the `overlap` samples before each as history."""
        for start in range(self.history, len(self.wrench), size):
            before = max(start - overlap, 0)
            yield self.part(before, start + size, start - before)

    def with_signals(self, inputs: Iterable[str]) -> Chunk:
        """The chunk with these signals alone, as far as present: less to transfer."""
        return replace(self, signals={name: self.signals[name] for name in inputs if name in self.signals})


def chunks(recording: Recording, size: int, overlap: int = 0, *, run: str | None = None) -> Iterator[Chunk]:
    """A recording in chunks, each with the samples before it as history.

    Parameters
    ----------
    recording : Recording
        The recording. Its signals are derived from the whole before it is cut.
    size : int
        Samples of a chunk after its history; a multiple of the noise's block.
    overlap : int, optional
        Samples of history, by default 0, as white noise needs; for coloured noise `NoiseModel.memory`.
    run : str, optional
        Name of the run, by default the recording's name.

    Returns
    -------
    iterator of Chunk
        Chunks in the order of time. Repeats that are separate runs are cut apart, without history from each other.

    Raises
    ------
    InputError
        For a size below 1 or below the overlap, or a recording that carries loads, on iteration.

    Examples
    --------
    >>> import truewrench as tw
    >>> recording = tw.read("train.csv", rig=tw.Rig.read("rig.toml"))
    >>> [(chunk.run, len(chunk.wrench)) for chunk in tw.chunks(recording, 2000, overlap=20)]
    [('train.csv', 2000), ('train.csv', 2020)]
    """
    if not size >= max(overlap, 1) or overlap < 0:
        what = f"chunks of {size} samples with an overlap of {overlap}"
        raise InputError(what=what, where=recording.name, remedy="give a size above 0 and not below the overlap")
    if recording.loads:
        what = f"it carries {recording.loads[0]}, which chunks do not say"
        raise InputError(what=what, where=recording.name, remedy="fit it as a whole recording")
    whole = Chunk(run=run or recording.name, signals=recording.motion.model_signals, wrench=recording.wrench)
    length = recording.samples if recording.continuous else recording.samples_per_repeat
    for begin in range(0, recording.samples, length):
        yield from whole.part(begin, begin + length).pieces(size, overlap)
