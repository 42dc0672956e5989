"""Tests of `modeling.chain`: regressors, stages and the pseudo-inertia."""
