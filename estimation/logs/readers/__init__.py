"""Readers of file formats: importing this package registers them all."""

from estimation.logs.readers import delimited_text, excel, hdf5, matlab, numpy_arrays, parquet, ros_bag

__all__ = ["delimited_text", "excel", "hdf5", "matlab", "numpy_arrays", "parquet", "ros_bag"]
