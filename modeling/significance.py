"""Significance levels and decision thresholds of the whole package, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class DecisionLevels:
    """Levels of all tests, and thresholds of all decisions that are not tests.

    A level is the probability of a false alarm under the null hypothesis: family-wise, over all that is searched in one
    recording or result, unless it says "each". A level is the stricter, the more a false alarm costs and the less it
    can be noticed afterwards.
    """

    effect: float = 0.01
    """Adding an effect (Holm over the candidates), and lack of fit in training (Bonferroni over bands, recordings).
    Family-wise per diagnosis: a false effect is a wrong statement about the rig, which somebody will look for. An
    effect that is as significant beside the final model, and is not in it, needs another reason than its p-value."""
    held_out: float = 0.001
    """Lack of fit on each held-out recording, ten of which are as one fitted: a false alarm rejects a right model, and
    the errors of the training estimates, which the test counts, are known to first order alone."""
    amount: float = 0.0455
    """Amount of an added effect, all its amplitudes together, that is told from none, each: two std of one amplitude.
    Its significance is by a score test, in whose noise another size may be reported with another std; one within two of
    nothing reads as nothing, and moves the tool's parameters all the same."""
    offset: float = 0.01
    """Point of application beside the tip axis (score test of x and y, each effect), given an effect on the axis. A
    false alarm costs two parameters with the std that they have; a miss leaves a point that is off by less than three
    of its std."""
    poorly_known_noise: float = 1e-4
    """Chi-square test, each, of an effect not significant by F: so much power is missed only because the noise was
    averaged over too few repeats. A false alarm costs a remark in a table."""
    drift_of_survey: float = 0.01
    """Trend or step in a survey, family-wise over its quantities (Bonferroni): a false alarm is a maintenance visit."""
    power: float = 0.8
    """Power with which the amount reported as detectable is detected: the usual convention."""
    upper_limit: float = 1.96
    """Standard deviations of the 95 % limit of an absent effect's contribution, each (two-sided normal): an effect is
    called negligible by it, which is said of one effect at a time."""
    residual_cells: float = 0.10
    """False discovery rate over the cells of one residual map: a map is looked at, and a grey cell in ten that is
    coloured misleads nobody as long as the others are right."""
    confusable: float = 10.8
    """Noncentrality lambda below which two models are confusable: the error probability Phi(-sqrt(lambda) / 2) of
    choosing between them is then 5 %, for each pair."""
    confusable_by_readings: float = 5.9
    """Chi-square of the readings that is higher with one of two models, below which they are confusable whatever their
    lambda: likelihoods of 19 to 1, 2 ln 19, each pair."""
    separated: float = 21.6
    """Noncentrality lambda from which on two models count as separated: an error probability of 1 %, each pair."""
    separated_by_readings: float = 9.2
    """Chi-square of the readings that is higher with one of two models, from which on they count as separated:
    likelihoods of 99 to 1, 2 ln 99, each pair."""
    nonzero: float = 2.58
    """Standard deviations of an estimate beyond which it differs from 0 at 1 %, each (two-sided normal): of an effect
    added by hand whose amplitudes are all below, the page says so."""
    transient: float = 0.01
    """A transient event in a single run, family-wise over its windows: samples inside it get a noise of their own, so
    that a false alarm costs little data."""
    transient_in_repeats: float = 0.001
    """A transient event in a recording with repeats, family-wise over all windows of one search. Up to three searches
    follow each other, and a false alarm leaves the affected lines out of the noise estimate."""
    tone: float = 0.001
    """A tone between the excited lines, family-wise over the lines: up to four searches follow each other, and each
    false alarm takes the largest of the noise's ordinates out of its spectrum."""
    ordinate: float = 0.01
    """An ordinate left out of a smooth power spectrum, family-wise over the ordinates: a false alarm leaves out one
    ordinate and its neighbours of very many."""
    excited_line: float = 0.01
    """An excited line in a spectrum of noise alone, family-wise over its lines: a false alarm raises the bandwidth of a
    derivative, and so its noise."""
    repeat_motion: float = 0.001
    """Motion that differs between repeats beyond its noise, family-wise over lines and columns: a false alarm costs
    time, as the readings decide afterwards; a miss leaves a difference that is below the noise of the motion."""
    outlier: float = 0.01
    """An outlier in a channel, family-wise over its samples: a false alarm downweights one sample."""
    constraint: float = 0.001
    """Rejection of an active constraint, each (one-sided, 3 std): it says that a physical law or a bound stated by the
    user contradicts the data, and there are up to a dozen constraints in a fit."""
    agreement: float = 0.01
    """Disagreement of bootstrap and analytic std, family-wise over a fit's parameters (Holm): a false alarm makes
    somebody search for a drift."""
    contact: float = 0.01
    """A contact in a record without one, family-wise over all windows; the default, as users may choose another."""
    tip_force: float = 0.01
    """A force at the tip that does not explain the mean wrench of a detected contact, family-wise over the contacts of
    a recording (Bonferroni): a false alarm costs a sentence below a table, a miss leaves the size of a force that
    nobody exerted."""
    quiet_segment: float = 0.001
    """A contact-free segment left out of the cluster about the sensor's zero, each: a false alarm loses one segment of
    two hundred."""
    contact_noise: float = 0.05
    """Noise at a time scale above the value used to detect contacts, each: it makes the level of `contact` hold where
    few differences determine that noise."""
    spectral_line: float = 0.01
    """A line marked in the plot of a residual's spectrum, family-wise over the excited lines of a channel."""
    misread: float = 0.01
    """Another reading of a recording's columns (order of a quaternion, axes, units) than their names say, family-wise
    over the readings: a false alarm costs a line of the reading report, or a map."""
    miscalibrated: float = 0.05
    """Rejection, one-sided, that false alarms are at most twice as frequent as stated: it takes the p-values of one
    recording away. A false alarm leaves the verdict, with its reasons, and the advice to repeat the motion."""
    confidence: float = 0.95
    """Coverage of confidence intervals, each: the usual convention."""


LEVELS = DecisionLevels()
"""The levels used unless a caller states others."""
