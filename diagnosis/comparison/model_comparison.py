"""Several models on the same recordings: where each fails, and which difference is significant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from diagnosis.comparison.comparison import MEASURES, NEGLIGIBLE_SHARE, Comparison, comparison_of, size_columns
from diagnosis.comparison.validation import validation_fit
from estimation.fit import Fit, reestimated_noise, require_recording
from estimation.fit_column_space import rows_of_recordings
from estimation.least_squares.estimates import Estimate, EstimatedModel
from estimation.multiplicity import chi2_sf, holm_adjusted, normal_cdf
from estimation.noise.recording_noise import RecordingNoise, sample_step
from estimation.recordings.recording import Recording, readings_digest
from modeling.chain.model import WrenchModel
from modeling.errors import InputError, kind_of
from modeling.noise import NoiseSource
from modeling.number_format import finite, p_value_text
from modeling.significance import LEVELS
from modeling.table import Column, Table, Tabular, Value

# Systematic error of each channel in octaves of frequency.


Array = NDArray[np.float64]

MAX_BANDS = 8
"""Octaves from the highest frequency down; all lower ones are one band."""
ROUNDING = 1e-9
"""Relative, of a frequency on an edge: it is inside."""


@dataclass(frozen=True, eq=False)
class BandError(Tabular):
    """RMS of a residual in frequency bands.

    edges       (b + 1,) Hz; the mean over the record is left out
    rms         (b, p) in the channels' units: with repeats of the part that repeats (systematic), else of the whole
    systematic  which of the two
    """

    comparison: Comparison
    edges: Array
    rms: Array
    systematic: bool

    @classmethod
    def of(cls, comparison: Comparison) -> BandError:
        """The bands of a compared recording.

        With R repeats the power of a harmonic that repeats is the mean of X_r X_s* over all pairs of different
        repeats, to which independent noise adds nothing on average; negative sums over a band are noise, and zero.
        """
        recording, step = comparison.recording, sample_step(comparison.recording)
        systematic = comparison.noise.source is NoiseSource.REPEATS
        repeats = recording.repeats if systematic else 1
        blocks = comparison.residual.reshape(repeats, -1, comparison.residual.shape[1])
        lines = np.fft.rfft(blocks, axis=1)[:, 1:] / blocks.shape[1]
        power = _repeating_power(lines) if systematic else np.abs(lines[0]) ** 2
        frequency = np.fft.rfftfreq(blocks.shape[1], step)[1:].astype(np.float64)
        weight = np.where(np.isclose(frequency, 0.5 / step), 1.0, 2.0)
        edges = octaves(frequency)
        band = np.searchsorted(edges, frequency, side="right") - 1
        sums = [(weight[:, None] * power)[band == b].sum(axis=0) for b in range(len(edges) - 1)]
        return cls(comparison, edges, np.sqrt(np.maximum(sums, 0.0)), systematic)

    def above(self, share: float) -> NDArray[np.bool_]:
        """Bands (b,) in which a channel's RMS exceeds this share of its noise floor."""
        floor = np.array(list(self.comparison.noise_floor.values()))
        return np.asarray((self.rms > share * floor).any(axis=1))

    @property
    def labels(self) -> list[str]:
        """Each band as text, Hz."""
        return [f"{low:.3g} to {high:.3g}" for low, high in zip(self.edges[:-1], self.edges[1:], strict=True)]

    @property
    def table(self) -> Table:
        """Bands and the RMS of each channel."""
        rows: list[tuple[Value, ...]] = [
            (label, *map(float, r)) for label, r in zip(self.labels, self.rms, strict=True)
        ]
        return Table.of((Column("band", "Hz"), *size_columns(self.comparison.space)), rows)

    def remarks(self) -> list[str]:
        """What the numbers are."""
        kind = "of the part that repeats with the motion" if self.systematic else "of the whole residual: no repeats"
        return [f"RMS {kind}"]


def _repeating_power(lines: NDArray[np.complex128]) -> Array:
    """Mean over pairs of different repeats of X_r X_s*, of lines (repeats, lines, p)."""
    repeats = len(lines)
    pairs = np.abs(lines.sum(axis=0)) ** 2 - (np.abs(lines) ** 2).sum(axis=0)
    return np.asarray(pairs / (repeats * (repeats - 1)))


def octaves(frequency: Array) -> Array:
    """Edges (b + 1,) in Hz: halves of the highest frequency, down to the lowest or to MAX_BANDS bands."""
    highest, lowest = float(frequency[-1]), float(frequency[0])
    count = min(MAX_BANDS, max(1, int(np.ceil(np.log2(highest / lowest)))))
    inner = highest / 2.0 ** np.arange(count - 1, 0, -1)
    return np.array([lowest * (1 - ROUNDING), *inner, highest * (1 + ROUNDING)])


EQUAL_PREDICTIONS = 1e-6
"""Distance of two predictions, in std of the noise over all rows, that is rounding: there is nothing to compare."""


@dataclass(frozen=True, eq=False)
class ModelOnRecording:
    """A model's prediction of one recording: number `number` of a fit, in the noise common to all models.

    fitted  whether the fit used the recording; if not it is a validation fit, in which the biases alone are estimated
    seen    whether the model's parameters were estimated from it, by this fit or before; None where that is not known
    """

    fit: Fit
    number: int
    fitted: bool
    seen: bool | None

    @cached_property
    def comparison(self) -> Comparison:
        """Residual statistics."""
        return comparison_of(self.fit, self.number)

    @cached_property
    def rows(self) -> Array:
        """The whitened residual."""
        return np.asarray(self.fit.whitened_residual()[rows_of_recordings(self.fit)[self.number]])


@dataclass(frozen=True, eq=False)
class ComparedModel:
    """A model under a name, with its parameters, and its predictions of the compared recordings."""

    name: str
    estimated: EstimatedModel
    predictions: tuple[ModelOnRecording, ...]

    @property
    def freedom(self) -> int:
        """Parameters estimated from the compared recordings, biases aside; none of a model fitted to others."""
        fit = next((p.fit for p in self.predictions if p.fitted), None)
        return 0 if fit is None else int(fit.identifiable[len(fit.model.biases) : len(fit.model.parameters)].sum())

    @cached_property
    def chi_square(self) -> float:
        """Whitened chi-square over all recordings."""
        return float(sum(p.rows @ p.rows for p in self.predictions))

    @property
    def information_criterion(self) -> float:
        """Akaike's: whitened chi-square plus twice the freedom. In whitened rows it holds for coloured noise."""
        return self.chi_square + 2 * self.freedom


@dataclass(frozen=True)
class ModelDifference:
    """Test of two models for equal error on the compared recordings.

    better   the name of the one with the smaller criterion, and `worse` the other's
    gain     difference of their information criteria
    p_value  of "both predict equally well", two-sided, Holm-adjusted over the pairs compared
    fitted   whether either was fitted to the compared recordings: it then describes them, and predicts nothing
    """

    better: str
    worse: str
    gain: float
    p_value: float
    fitted: bool = False

    @property
    def sentence(self) -> str:
        """The result in words."""
        p_value = p_value_text(self.p_value)
        if self.p_value < LEVELS.effect:
            verb = "describes these recordings, which were fitted," if self.fitted else "predicts"
            return f"{self.better} {verb} better than {self.worse} ({p_value})"
        return f"no significant difference between {self.better} and {self.worse} ({p_value})"


@dataclass(frozen=True, eq=False)
class ModelComparison(Tabular):
    """Models on the same recordings, in the order given, and tests of their differences."""

    models: tuple[ComparedModel, ...]

    @property
    def recordings(self) -> tuple[Recording, ...]:
        """The recordings compared."""
        return tuple(p.comparison.recording for p in self.models[0].predictions)

    @cached_property
    def differences(self) -> tuple[ModelDifference, ...]:
        """Tests of all pairs of models."""
        pairs = list(combinations(self.models, 2))
        adjusted = holm_adjusted([equal_error_p_value(a, b) for a, b in pairs])
        differences = []
        for (a, b), p_value in zip(pairs, adjusted, strict=True):
            gain = a.information_criterion - b.information_criterion
            better, worse = (b, a) if gain > 0 else (a, b)
            fitted = any(p.seen for model in (a, b) for p in model.predictions)
            differences.append(ModelDifference(better.name, worse.name, abs(gain), p_value, fitted))
        return tuple(differences)

    @property
    def table(self) -> Table:
        """Error of each channel, reduced chi-square and lack of fit of each model on each recording.

        The error is the systematic RMS, or its upper limit, with repeats, the RMS of the whole residual without.
        """
        rows = [(_recording_label(p), m.name, *p.comparison.errors) for m in self.models for p in m.predictions]
        space = self.models[0].predictions[0].comparison.space
        return Table.of(("recording", "model", *size_columns(space), *MEASURES), rows)

    @property
    def parameter_table(self) -> Table:
        """Value and std of each parameter in each model, biases aside, and its change from the first model in std."""
        columns: list[Column] = [Column("parameter"), Column("unit")]
        for number, model in enumerate(self.models):
            columns += [Column(model.name, format=".5g"), Column("std", format=".2g")]
            columns += [Column("change / std", format=".1f")] * (number > 0)
        names = list(dict.fromkeys(name for model in self.models for name in _estimates(model)))
        return Table.of(columns, [self._parameter_row(name) for name in names])

    def _parameter_row(self, name: str) -> tuple[Any, ...]:
        estimates = [_estimates(model).get(name) for model in self.models]
        first, unit = estimates[0], next(e.unit for e in estimates if e is not None)
        row: list[Any] = [name, unit]
        for number, estimate in enumerate(estimates):
            row += [None, None] if estimate is None else [estimate.known, estimate.std]
            if number:
                row.append(None if first is None or estimate is None else _change(first, estimate))
        return tuple(row)

    @property
    def band_table(self) -> Table:
        """Error of each channel in octaves of frequency, of each model on each recording.

        Bands in which no channel of any model reaches `NEGLIGIBLE_SHARE` of its noise floor are left out.
        """
        rows: list[tuple[Any, ...]] = []
        moving = [i for i, r in enumerate(self.recordings) if not r.at_rest]
        for number in moving:
            predictions = [model.predictions[number] for model in self.models]
            bands = [BandError.of(p.comparison) for p in predictions]
            shown = np.any([b.above(NEGLIGIBLE_SHARE) for b in bands], axis=0)
            for model, prediction, band in zip(self.models, predictions, bands, strict=True):
                kept = [row for row, keep in zip(band.table.rows, shown, strict=True) if keep]
                rows += [(_recording_label(prediction), model.name, *row) for row in kept]
        columns = BandError.of(self.models[0].predictions[moving[0]].comparison).table.columns if moving else ()
        return Table.of(("recording", "model", *columns), rows)

    def remarks(self) -> list[str]:
        """Which models differ significantly, and what was estimated on recordings that they were not fitted on."""
        dwelling = [f"{r.name} is read as {r.dwells.counted}." for r in self.recordings if r.dwells is not None]
        remarks = [
            *dwelling,
            *(r.carried for r in self.recordings if r.loads),
            *(f"{difference.sentence}." for difference in self.differences),
        ]
        if any(not p.fitted for model in self.models for p in model.predictions):
            remarks.append("Fitted on: the recording is one that the model was fitted to; held out: it is not.")
            remarks.append("The biases, which differ between recordings, are estimated on each.")
        return remarks

    def printed(self) -> list[Table | str]:
        """Errors, differences, parameters, bands."""
        printed = [*super().printed(), "", self.parameter_table]
        if len(self.models) > 1:
            printed.append(f"change / std: from {self.models[0].name}, in its std")
        return [*printed, "", self.band_table] if self.band_table.rows else printed

    def to_data(self) -> dict[str, Any]:
        """Plain data: numbers are finite or None."""
        data: dict[str, Any] = finite(
            {
                "recordings": [r.name for r in self.recordings],
                "models": [_model_data(model) for model in self.models],
                "differences": [{**vars(d), "significant": d.p_value < LEVELS.effect} for d in self.differences],
            }
        )
        return data


@overload
def compare(fit: Fit, recording: Recording | None = None) -> Comparison: ...


@overload
def compare(
    fit: Sequence[EstimatedModel] | Mapping[str, EstimatedModel],
    recording: Recording | Sequence[Recording] | None = None,
) -> ModelComparison: ...


def compare(
    fit: Fit | EstimatedModel | Sequence[EstimatedModel] | Mapping[str, EstimatedModel],
    recording: Recording | Sequence[Recording] | None = None,
    *more: object,
) -> Comparison | ModelComparison:
    """Compare a fit with a recording, or several fits with each other on the same recordings.

    Parameters
    ----------
    fit : Fit or ModelFile, sequence of these, or mapping of str to these
        A fit of a model to recordings, or what `load` gave; several, or several by name.
    recording : Recording, or of several fits a sequence of them, optional
        One of the fit's recordings, by default the first; or a held-out one of the same rig and tool, on which the
        biases alone are re-estimated (validation fit), and whose test of lack of fit counts what the fit's own
        recordings leave uncertain of the parameters. Of several fits by default the recordings of the first.
    *more : object
        Nothing: several fits are one argument, a list, and so are several recordings.

    Returns
    -------
    Comparison or ModelComparison
        Residual (n, p), measured minus predicted, and RMS, noise floor and systematic error of each channel, N and N m;
        reduced chi-square, and the p-value of "the residual is consistent with the noise" (`lack_of_fit`). Of several
        fits these of each, by frequency band too, with tests of their differences and the change of each parameter.

    Raises
    ------
    InputError
        When a recording lacks a signal that a model needs, nothing is given to compare, or the arguments are no fits
        and recordings.

    Examples
    --------
    >>> import truewrench as tw
    >>> rig = tw.Rig.read("rig.toml")
    >>> train, other = tw.read("train.csv", rig=rig), tw.read("validate.csv", rig=rig)
    >>> fit = tw.fit(tw.planar(rig), train)
    >>> found = tw.compare(fit, other)
    >>> {channel: round(rms, 2) for channel, rms in found.rms.items()}
    {'fx': 0.5, 'fy': 0.27, 'tau': 0.06}
    >>> found.lack_of_fit < 0.01
    True
    >>> better = tw.fit(tw.planar(rig) + tw.effects.viscous_drag(), train)
    >>> tw.compare([fit, better], other).differences[0].better
    'rigid tool + viscous_drag'
    """
    _require_fits_and_recordings(fit, recording, more)
    if not isinstance(fit, Fit):
        named = fit if isinstance(fit, Mapping) else _named([fit] if isinstance(fit, EstimatedModel) else fit)
        several = (recording,) if isinstance(recording, Recording) else tuple(recording or _own_recordings(named))
        return compare_models(named, several)
    if not isinstance(recording, Recording | None):
        return compare_models(_named([fit]), recording)
    number = 0 if recording is None else fit.number_of(recording)
    if recording is None or number is not None:
        return comparison_of(fit, number or 0)
    return comparison_of(validation_fit(fit, recording), 0)


def _require_fits_and_recordings(fit: object, recording: object, more: tuple[object, ...]) -> None:
    """InputError, in a sentence, for arguments of other kinds, and for fits that are not in a list."""
    remedy = "give the fits as a list, then the recording: tw.compare([first, second], recording)"
    if more or isinstance(recording, Fit):
        raise InputError(what="several fits are one argument", where="compare", remedy=remedy)
    fits = fit.values() if isinstance(fit, Mapping) else fit if isinstance(fit, list | tuple) else (fit,)
    for one in fits:
        if not isinstance(one, EstimatedModel):
            raise InputError(what=f"{kind_of(one)} is no fit", where="compare", remedy=remedy)
    several = recording if isinstance(recording, list | tuple) else () if recording is None else (recording,)
    for each in several:
        require_recording(each, "compare")


def _named(fits: Sequence[EstimatedModel]) -> dict[str, EstimatedModel]:
    """Fits by what their models are: the rigid tool and effects; numbered where two are alike."""
    named: dict[str, EstimatedModel] = {}
    for fit in fits:
        label = model_label(fit.model)
        alike = sum(name.split(" #")[0] == label for name in named)
        named[f"{label} #{alike + 1}" if alike else label] = fit
    return named


def model_label(model: WrenchModel) -> str:
    """What a model is, in short: `rigid tool + viscous_drag`."""
    return " + ".join(["rigid tool", *(effect.id for effect in model.effects)])


def _own_recordings(named: Mapping[str, EstimatedModel]) -> tuple[Recording, ...]:
    return next((fit.recordings for fit in named.values() if isinstance(fit, Fit)), ())


def compare_models(models: Mapping[str, EstimatedModel], recordings: Sequence[Recording]) -> ModelComparison:
    """Compare models, by name, on recordings: each in one noise that is common to all models.

    Raises InputError when a recording lacks a signal that a model needs, or has other channels.
    """
    if not models or not recordings:
        raise InputError(what="nothing to compare", where="compare", remedy="give models and recordings")
    columns = [_on_recording(list(models.values()), recording) for recording in recordings]
    return ModelComparison(
        tuple(
            ComparedModel(name, estimated, tuple(column[i] for column in columns))
            for i, (name, estimated) in enumerate(models.items())
        )
    )


def _on_recording(models: Sequence[EstimatedModel], recording: Recording) -> list[ModelOnRecording]:
    """Each model's prediction of a recording, in one noise."""
    from estimation.readings.static_dwells import sampled  # of models that are compared by hand alone

    if all(_own_prediction(model, recording) is None for model in models):
        recording = sampled(recording, models[0].model)
    predicted = [
        _own_prediction(model, recording)
        or ModelOnRecording(validation_fit(model, recording), 0, False, _was_fitted_on(model, recording))
        for model in models
    ]
    noise = _common_noise(predicted)
    return [
        _in_noise(p, noise) if p.fitted else replace(p, fit=validation_fit(m, recording, noise))
        for p, m in zip(predicted, models, strict=True)
    ]


def _own_prediction(model: EstimatedModel, recording: Recording) -> ModelOnRecording | None:
    """The fit's own prediction of a recording that it used; None of another."""
    number = model.number_of(recording) if isinstance(model, Fit) else None
    return ModelOnRecording(model, number, True, True) if isinstance(model, Fit) and number is not None else None


def _common_noise(predicted: Sequence[ModelOnRecording]) -> RecordingNoise:
    """The noise with the smallest floor: one that comes from a residual has that model's error in it."""
    noises = [p.fit.noise[p.number] if p.fitted else _noise_of(p.fit) for p in predicted]
    return min(noises, key=lambda noise: float(np.log(np.maximum(noise.floor, 1e-300)).sum()))


def _noise_of(fit: Fit) -> RecordingNoise:
    (noise,) = reestimated_noise(fit) if fit.noise[0].source is NoiseSource.RESIDUAL else fit.noise
    return noise


def _in_noise(prediction: ModelOnRecording, noise: RecordingNoise) -> ModelOnRecording:
    noises = list(prediction.fit.noise)
    noises[prediction.number] = noise
    return replace(prediction, fit=replace(prediction.fit, problem=prediction.fit.problem.in_noise(noises)))


def equal_error_p_value(first: ComparedModel, second: ComparedModel) -> float:
    """P-value of "both models predict equally well", two-sided.

    Let r1, r2 be the whitened residuals of all recordings and d = r1 - r2 the difference of the predictions. Where both
    err equally, r1 = n + d/2 and r2 = n - d/2 with noise n of unit variance, up to errors that they share, and
    |r1|² - |r2|² = 2 d.n is normal with std 2 |d|. Parameters estimated from the same data lower a chi-square by one
    each on average, and again its expectation elsewhere (Akaike): the criteria take the place of the squares. Of nested
    models that were fitted to the same recordings the difference is tested by chi-square (likelihood ratio).
    """
    difference = [a.rows - b.rows for a, b in zip(first.predictions, second.predictions, strict=True)]
    distance = float(np.sqrt(sum(d @ d for d in difference)))
    smaller, larger = sorted((first, second), key=lambda m: m.freedom)
    if _nested(smaller, larger):
        gain = max(0.0, smaller.chi_square - larger.chi_square)
        return float(chi2_sf(gain, larger.freedom - smaller.freedom))
    if distance < EQUAL_PREDICTIONS:
        return 1.0
    deviation = abs(first.information_criterion - second.information_criterion) / (2 * distance)
    return float(2 * normal_cdf(-deviation))


def _nested(smaller: ComparedModel, larger: ComparedModel) -> bool:
    """Whether both were fitted to the compared recordings, and the larger has every effect of the smaller, and more."""
    few, many = ({e.id for e in m.estimated.model.effects} for m in (smaller, larger))
    fitted = all(p.fitted for m in (smaller, larger) for p in m.predictions)
    return fitted and few < many and larger.freedom > smaller.freedom


def _estimates(model: ComparedModel) -> dict[str, Estimate]:
    """The model's own parameters, biases aside."""
    biases = {p.name for p in model.estimated.model.biases}
    names = [p.name for p in model.estimated.model.parameters if p.name not in biases]
    return {name: model.estimated.parameters[name] for name in names}


def _change(first: Estimate, other: Estimate) -> float:
    """Change of a parameter, in the std of the first model."""
    return (other.value - first.value) / first.std if first.std > 0 else np.nan


def _recording_label(prediction: ModelOnRecording) -> str:
    use = {True: "fitted on", False: "held out", None: "biases alone fitted"}[prediction.seen]
    return f"{prediction.comparison.recording.name} ({use})"


def _was_fitted_on(model: EstimatedModel, recording: Recording) -> bool | None:
    """Whether a model's parameters were estimated from these readings; None where its file does not say."""
    digests = map(readings_digest, model.recordings) if isinstance(model, Fit) else getattr(model, "fitted_on", None)
    return None if digests is None else readings_digest(recording) in list(digests)


def _model_data(model: ComparedModel) -> dict[str, Any]:
    recordings = [
        {
            "recording": p.comparison.recording.name,
            "fitted": p.fitted,
            "fitted_on": p.seen,
            "rms": dict(p.comparison.rms),
            "explainable_rms": None if p.comparison.explainable_rms is None else dict(p.comparison.explainable_rms),
            "misfit": p.comparison.misfit,
            "lack_of_fit_p": p.comparison.lack_of_fit,
        }
        for p in model.predictions
    ]
    return {
        "model": model.name,
        "effects": [e.id for e in model.estimated.model.effects],
        "information_criterion": model.information_criterion,
        "recordings": recordings,
        "parameters": {n: {"value": e.value, "std": e.std, "unit": e.unit} for n, e in _estimates(model).items()},
    }
