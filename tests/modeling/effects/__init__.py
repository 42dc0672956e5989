"""What every effect of the catalogue keeps; `checks` are the conditions, `cases` the effects in both spaces."""
