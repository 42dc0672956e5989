"""Server of the workbench: who may ask, the pages, the files that they send."""
