"""Tests of `estimation.reading`: logs of every format, and their authors' mistakes."""
