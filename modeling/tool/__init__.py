"""Rigid-body dynamics of the tool and the components of contact wrenches."""
